// Enlarging small images by interpolation. Simulated images are often sampled just finely enough for the
// scattering that made them; Lanczos interpolation over three pixels, as in the PNG pictures, shows what
// lies between their samples.

/** Enlarged images have at most so many pixels. */
const ENLARGED = 4e6;

/** Pixels to be made of one, along each axis: 8 for small images, 1 for those that stay as they are. */
function enlargement([width, height]) {
  if (Math.max(width, height) > HEADER.tile) return 1;
  return [8, 4, 2].find((factor) => width * height * factor * factor <= ENLARGED) ?? 1;
}

const sinc = (x) => (x === 0 ? 1 : Math.sin(Math.PI * x) / (Math.PI * x));

/** Rows of `width` values with `factor` values for each. */
function enlargeRows(values, width, height, factor) {
  const out = new Float32Array(width * factor * height);
  for (let i = 0; i < width * factor; i++) {
    const at = (i + 0.5) / factor - 0.5;
    const first = Math.floor(at) - 2;
    const weights = Array.from({ length: 6 }, (_, k) => sinc(at - first - k) * sinc((at - first - k) / 3));
    const sum = weights.reduce((a, b) => a + b, 0);
    for (let k = 0; k < 6; k++) {
      const from = Math.min(Math.max(first + k, 0), width - 1);
      const weight = weights[k] / sum;
      for (let j = 0; j < height; j++) out[j * width * factor + i] += weight * values[j * width + from];
    }
  }
  return out;
}

function transposed(values, width, height) {
  const out = new Float32Array(values.length);
  for (let j = 0; j < height; j++) for (let i = 0; i < width; i++) out[i * height + j] = values[j * width + i];
  return out;
}

/** An image with `factor` squared pixels for each. */
function enlarge(values, width, height, factor) {
  const wide = enlargeRows(values, width, height, factor);
  const turned = enlargeRows(transposed(wide, width * factor, height), height, width * factor, factor);
  return transposed(turned, height * factor, width * factor);
}
