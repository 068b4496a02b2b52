// What is drawn over the image: phases, columns, defects, boundaries, particles.
// The colours are those of the PNG pictures (Okabe and Ito 2008).

const COLORS = {
  vacancy: [213, 94, 0], substitution: [204, 121, 167], column: [86, 220, 233], line: [240, 228, 66],
  phases: [[0, 114, 178], [230, 159, 0], [86, 180, 233], [0, 158, 115], [240, 228, 66]],
};
/** How much of the image the tint of a phase hides. */
const WASH = 0.3;
/** Radius of a ring in nm, as in the pictures. */
const RING = 0.085;
/** Rings are drawn where columns are so many CSS pixels apart; a tint elsewhere. */
const APART = 9;
/** Edge of a cached piece of the overlay in device pixels. */
const PIECE = 512;
/** Milliseconds of a frame that new pieces may take. */
const BUDGET = 7;

const css = ([r, g, b], alpha = 1) => `rgb(${r} ${g} ${b} / ${alpha})`;

/** A ring as a little canvas, which is quicker to draw many times than a path. */
function ringStamp(radius, color, alpha) {
  const width = Math.min(Math.max(0.22 * radius, 1.2), 6);
  const size = Math.ceil(2 * (radius + width)) + 2;
  const canvas = Object.assign(document.createElement("canvas"), { width: size, height: size });
  const context = canvas.getContext("2d");
  context.lineWidth = width;
  context.strokeStyle = css(color, alpha);
  context.beginPath();
  context.arc(size / 2, size / 2, radius, 0, 2 * Math.PI);
  context.stroke();
  return canvas;
}

/** Rings about columns, in pieces that stay while the view moves. */
class Rings {
  constructor(columns) {
    this.columns = columns;
    this.pieces = new Map();
    this.scale = 0;
  }

  clear() {
    this.pieces.clear();
    this.stamps = new Map();
  }

  stamp(color, share) {
    // Eight strengths will do.
    const strength = Math.ceil(Math.min(0.3 + 1.4 * share, 1) * 8) / 8;
    const key = color + "/" + strength;
    if (!this.stamps.has(key)) this.stamps.set(key, ringStamp(this.radius, color, strength));
    return this.stamps.get(key);
  }

  /** Draws; returns whether everything is there and sharp. */
  draw(context, view, shown, moving) {
    const kinds = (shown.has("columns") ? "c" : "") + (shown.has("defects") ? "d" : "");
    const scale = view.scale * view.ratio;
    const drift = scale / (this.scale || 1e-9);
    if (kinds !== this.kinds || (scale !== this.scale && (!moving || drift > 2 || drift < 0.5))) {
      Object.assign(this, { kinds, scale, radius: Math.max(this.columns.ring * scale, 3 * view.ratio) });
      this.clear();
    }
    const began = performance.now();
    const span = PIECE / this.scale;
    const [x0, y0, x1, y1] = view.seen().map((v) => Math.floor(v / span));
    let complete = scale === this.scale;
    for (let j = y0; j <= y1; j++) for (let i = x0; i <= x1; i++) {
      const key = i + "/" + j;
      if (!this.pieces.has(key)) {
        if (performance.now() - began > BUDGET) {
          complete = false;
          continue;
        }
        this.pieces.set(key, this.piece(i, j, span, shown));
      }
      const piece = this.pieces.get(key);
      const size = (PIECE * scale) / this.scale;
      const at = view.toScreen(i * span, j * span).map((v) => v * view.ratio);
      if (piece) context.drawImage(piece, at[0], at[1], size, size);
    }
    if (this.pieces.size > 400) this.clear();
    return complete;
  }

  piece(i, j, span, shown) {
    const reach = (1.3 * this.radius + 4) / this.scale;
    const [left, top] = [i * span, j * span];
    let context = null;
    const put = (x, y, color, share) => {
      context ??= Object.assign(document.createElement("canvas"), { width: PIECE, height: PIECE }).getContext("2d");
      const stamp = this.stamp(color, share);
      context.drawImage(stamp, (x - left) * this.scale - stamp.width / 2, (y - top) * this.scale - stamp.height / 2);
    };
    this.columns.within([left - reach, top - reach, left + span + reach, top + span + reach], (k, x, y) => {
      const { sites, vacancies, substitutions } = this.columns.contents(k);
      if (shown.has("columns")) put(x, y, COLORS.column, 0.3);
      if (!shown.has("defects")) return;
      if (vacancies > 0) put(x, y, COLORS.vacancy, vacancies / Math.max(sites, vacancies));
      if (substitutions > 0) put(x, y, COLORS.substitution, substitutions / Math.max(sites, substitutions));
    });
    return context?.canvas ?? null;
  }
}

/** A picture of how many defects lie where, for zooms at which columns are too small. */
function densityPicture(columns, bounds) {
  const longest = Math.max(bounds[2] - bounds[0], bounds[3] - bounds[1]);
  const cell = Math.max(longest / 400, 0.5);
  const [width, height] = [0, 1].map((k) => Math.max(1, Math.ceil((bounds[k + 2] - bounds[k]) / cell)));
  const canvas = Object.assign(document.createElement("canvas"), { width, height });
  const context = canvas.getContext("2d");
  for (const [kind, color] of [["vacancies", COLORS.vacancy], ["substitutions", COLORS.substitution]]) {
    const sums = new Float32Array(width * height);
    columns.within(bounds, (k, x, y) => {
      const i = Math.min(Math.floor((x - bounds[0]) / cell), width - 1);
      const j = Math.min(Math.floor((y - bounds[1]) / cell), height - 1);
      sums[j * width + i] += columns.contents(k)[kind];
    });
    const most = sums.reduce((a, b) => Math.max(a, b), 0);
    if (most === 0) continue;
    const layer = Object.assign(document.createElement("canvas"), { width, height });
    const image = new ImageData(width, height);
    const pixels = new Uint32Array(image.data.buffer);
    sums.forEach((sum, i) => { pixels[i] = packed(color, Math.round((230 * sum) / most)); });
    layer.getContext("2d").putImageData(image, 0, 0);
    context.drawImage(layer, 0, 0);
  }
  return { canvas, bounds: [bounds[0], bounds[1], bounds[0] + width * cell, bounds[1] + height * cell] };
}

class Overlays {
  constructor(columns, phases, bounds) {
    Object.assign(this, { columns, phases, bounds, shown: new Set() });
    this.rings = columns ? new Rings(columns) : null;
    this.available = [
      ["defects", Boolean(columns && HEADER.columns.kinds.some((k) => k[1] + k[2] > 0))],
      ["phases", Boolean(phases)],
      ["boundaries", HEADER.boundaries.length > 0],
      ["particles", HEADER.particles.length > 0],
      ["columns", Boolean(columns)],
    ].filter(([, there]) => there).map(([name]) => name);
  }

  /** What is switched on where nothing is asked for: marks that leave the image to be seen; all columns where there is nothing else. */
  get usual() {
    const marks = this.available.filter((name) => !["phases", "columns"].includes(name));
    return marks.length > 0 ? marks : this.available;
  }

  /** Whether columns are far enough apart for rings. */
  near(view) {
    return this.columns?.loaded && view.scale >= APART * this.columns.perUnit;
  }

  /** Draws all that is switched on; returns whether everything was there. */
  draw(context, view, moving, place, frame) {
    let complete = true;
    const { shown } = this;
    if (shown.has("phases") && this.phases) {
      const part = view.seen().map((v, k) => (v - this.bounds[k % 2]) / HEADER.pixel[k % 2]);
      const size = view.scale * view.ratio * Math.max(...HEADER.pixel);
      context.imageSmoothingEnabled = false;
      complete = this.phases.draw(context, this.phases.levelFor(size), part, place, frame) && complete;
    }
    if (this.columns?.loaded && (shown.has("defects") || shown.has("columns"))) {
      context.imageSmoothingEnabled = true;
      if (this.near(view)) complete = this.rings.draw(context, view, shown, moving) && complete;
      else if (shown.has("defects")) this.drawDensity(context, view);
    }
    context.save();
    context.scale(view.ratio, view.ratio);
    if (shown.has("boundaries")) HEADER.boundaries.forEach((b) => this.line(context, view, b.points));
    if (shown.has("particles")) HEADER.particles.forEach((p) => this.circle(context, view, p));
    context.restore();
    return complete;
  }

  drawDensity(context, view) {
    this.density ??= densityPicture(this.columns, this.bounds);
    const [x0, y0, x1, y1] = this.density.bounds;
    const [left, top] = view.toScreen(x0, y0).map((v) => v * view.ratio);
    const [right, bottom] = view.toScreen(x1, y1).map((v) => v * view.ratio);
    context.drawImage(this.density.canvas, left, top, right - left, bottom - top);
  }

  line(context, view, points) {
    const path = new Path2D();
    points.forEach(([x, y], i) => path[i === 0 ? "moveTo" : "lineTo"](...view.toScreen(x, y)));
    this.twice(context, path);
  }

  circle(context, view, particle) {
    const path = new Path2D();
    path.arc(...view.toScreen(...particle.centre), (particle.diameter / 2) * view.scale, 0, 2 * Math.PI);
    this.twice(context, path);
  }

  /** A line with a dark rim, to be seen on any ground. */
  twice(context, path) {
    context.lineJoin = "round";
    for (const [width, color] of [[4.5, "rgb(0 0 0 / .5)"], [2, css(COLORS.line)]]) {
      context.lineWidth = width;
      context.strokeStyle = color;
      context.stroke(path);
    }
  }

  /** Lines of the legend: mark, colour, text. */
  legend(view) {
    const lines = [];
    const add = (name, ...line) => this.shown.has(name) && lines.push(line);
    const { columns } = this;
    if (columns?.loaded) {
      const mark = this.near(view) ? "ring" : "area";
      if (columns.vacancies) add("defects", mark, COLORS.vacancy, `${columns.vacancies} vacancies`);
      if (columns.substitutions) add("defects", mark, COLORS.substitution, `${columns.substitutions} substitutions`);
      const far = this.near(view) ? "" : " (zoom in to see them)";
      add("columns", "ring", COLORS.column, `${columns.header.count} columns${far}`);
    }
    HEADER.phases?.names.forEach((name, code) => {
      if (code > 0) add("phases", "area", COLORS.phases[(code - 1) % 5], name || `phase ${code}`);
    });
    for (const text of new Set(HEADER.boundaries.map((b) => b.text))) add("boundaries", "line", COLORS.line, text);
    const { length } = HEADER.particles;
    if (length) add("particles", "ring", COLORS.line, length === 1 ? "1 particle" : `${length} particles`);
    return lines;
  }
}
