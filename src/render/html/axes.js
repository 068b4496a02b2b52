// Rulers, scale bar, bar of colours.

/** Draws rulers at the left and below. */
function drawRulers(context, view, style) {
  const { width, height, ratio } = view;
  const [left, bottom] = [RULER.left, height - RULER.bottom];
  context.save();
  context.scale(ratio, ratio);
  context.fillStyle = style.panel;
  context.fillRect(0, 0, left, height);
  context.fillRect(0, bottom, width, RULER.bottom);
  context.strokeStyle = context.fillStyle = style.ink;
  context.lineWidth = 1;
  context.font = "12px system-ui, sans-serif";
  const [x0, y0, x1, y1] = view.seen();
  context.beginPath();
  context.textAlign = "center";
  context.textBaseline = "top";
  const across = ticks(x0, x1, (width - left) / 110);
  for (const value of across) {
    const [x] = view.toScreen(value, 0);
    context.moveTo(x, bottom);
    context.lineTo(x, bottom + 4);
    if (x > left + 14 && x < width - 60) context.fillText(tickText(value, across[1] - across[0] || 1), x, bottom + 7);
  }
  context.textAlign = "right";
  context.fillText(`x (${HEADER.unit})`, width - 6, bottom + 7);
  context.textBaseline = "middle";
  const down = ticks(y0, y1, bottom / 90);
  for (const value of down) {
    const [, y] = view.toScreen(0, value);
    context.moveTo(left - 4, y);
    context.lineTo(left, y);
    if (y > 30 && y < bottom - 6) context.fillText(tickText(value, down[1] - down[0] || 1), left - 7, y);
  }
  context.fillText(`y (${HEADER.unit})`, left - 7, 12);
  context.stroke();
  context.restore();
}

/** The longest of 1, 2, 5 times a power of ten that fits. */
function barLength(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  return [5, 2, 1].map((k) => k * power).find((length) => length <= most * (1 + 1e-9));
}

function lengthText(length, unit) {
  const nm = unit === "nm" ? length : length / 10;
  if (nm < 0.9999) return `${digits(nm * 10, 1)} Å`;
  return nm < 1000 ? `${digits(nm, 1)} nm` : `${digits(nm / 1000, 1)} µm`;
}

function updateScaleBar(view) {
  const bar = document.getElementById("scalebar");
  const length = barLength(Math.min(180, 0.3 * view.width) / view.scale);
  const [label, line] = bar.children;
  label.textContent = lengthText(length, HEADER.unit);
  line.style.width = `${length * view.scale}px`;
  bar.dataset.length = length;
}

/** Shows the colours and the values at their ends. */
function updateColorBar(colors, [low, high], image) {
  const rounded = image.exact ? "" : ", kept to 0.025 % of its range";
  document.getElementById("quantity").textContent = image.quantity + rounded;
  const context = document.querySelector("#colorbar canvas").getContext("2d");
  const strip = context.createImageData(256, 1);
  new Uint32Array(strip.data.buffer).set(colors);
  context.putImageData(strip, 0, 0);
  for (const [name, value] of [["low", low], ["high", high]]) {
    const end = document.getElementById("colorbar-" + name);
    const shown = value * image.scale + image.offset;
    end.textContent = digits(shown, 3);
    end.dataset.value = shown;
  }
}
