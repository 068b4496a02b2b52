// Intensity along a line that was drawn by dragging.

const SVG = "http://www.w3.org/2000/svg";
/** Margins of the plot in CSS pixels. */
const PLOT = { left: 78, right: 14, top: 10, bottom: 38 };

/** Round values for the ticks of an axis. */
function ticks(low, high, about) {
  const rough = (high - low) / about;
  if (!(rough > 0)) return [low];
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= rough);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return found;
}

/** Text of a tick, given their distance. */
function tickText(value, step) {
  const decimals = Math.min(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), 10);
  return (Math.abs(value) < step * 1e-6 ? 0 : value).toFixed(decimals);
}

function svg(name, attributes, text) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  return element;
}

class Profile {
  constructor(changed) {
    this.changed = changed;
    this.section = document.getElementById("profile");
    this.plot = document.getElementById("plot");
    this.width = document.getElementById("profile-width");
    this.line = null;
    this.marked = null;
    this.plot.addEventListener("pointermove", (event) => this.point(event));
    this.plot.addEventListener("pointerleave", () => { this.marked = null; this.mark(); });
  }

  close() {
    this.line = this.curves = this.marked = null;
    this.section.hidden = true;
    this.changed();
  }

  /** Samples images along the line (positions on the axes) and plots them. */
  async show(from, to, images) {
    this.line = [from, to];
    const turn = (this.turn = (this.turn ?? 0) + 1);
    const across = Math.min(Math.max(Math.round(Number(this.width.value)) || 1, 1), 201);
    const samples = this.samples(across);
    const curves = [];
    for (const image of images) {
      await image.pyramid.ready(samples.flatMap((s) => s.points));
      if (turn !== this.turn || !this.line) return;
      const mean = (points) => points.reduce((sum, p) => sum + image.pyramid.interpolated(...p), 0) / points.length;
      curves.push({
        name: image.name, quantity: image.quantity,
        values: samples.map((s) => mean(s.points) * image.scale + image.offset),
      });
    }
    this.curves = curves;
    this.distances = samples.map((s) => s.distance);
    this.section.hidden = false;
    this.draw();
    this.changed();
  }

  /** Points along the line, half a pixel apart, each with those across the line to be averaged. */
  samples(across) {
    const [from, to] = this.line;
    const pixel = Math.min(...HEADER.pixel);
    const length = Math.hypot(to[0] - from[0], to[1] - from[1]);
    const count = Math.min(Math.max(Math.ceil(length / (0.5 * pixel)), 1), 20000);
    const along = [(to[0] - from[0]) / length, (to[1] - from[1]) / length];
    return Array.from({ length: count + 1 }, (_, k) => {
      const distance = (length * k) / count;
      const points = Array.from({ length: across }, (_, n) => {
        const aside = (n - (across - 1) / 2) * pixel;
        const x = from[0] + along[0] * distance - along[1] * aside;
        const y = from[1] + along[1] * distance + along[0] * aside;
        return [(x - HEADER.origin[0]) / HEADER.pixel[0], (y - HEADER.origin[1]) / HEADER.pixel[1]];
      });
      return { distance, points };
    });
  }

  get length() {
    return this.distances[this.distances.length - 1];
  }

  draw() {
    const { plot, curves } = this;
    const [width, height] = [plot.clientWidth || 600, plot.clientHeight || 200];
    plot.setAttribute("viewBox", `0 0 ${width} ${height}`);
    const all = curves.flatMap((c) => c.values);
    let [low, high] = [all.reduce((a, b) => Math.min(a, b), Infinity), all.reduce((a, b) => Math.max(a, b), -Infinity)];
    const room = (high - low) * 0.06 || Math.abs(high) * 0.1 || 1;
    [low, high] = [low >= 0 && low < room * 3 ? 0 : low - room, high + room];
    const inner = [width - PLOT.left - PLOT.right, height - PLOT.top - PLOT.bottom];
    this.x = (distance) => PLOT.left + (inner[0] * distance) / this.length;
    const y = (value) => PLOT.top + inner[1] * (1 - (value - low) / (high - low));
    plot.replaceChildren();
    this.axes(low, high, y, inner);
    curves.forEach((curve, n) => {
      const points = curve.values.map((v, k) => `${this.x(this.distances[k]).toFixed(2)},${y(v).toFixed(2)}`);
      plot.append(svg("polyline", { class: `curve curve-${n}`, points: points.join(" ") }));
      const at = { class: `key-${n}`, x: width - PLOT.right - 4, y: PLOT.top + 12 + 15 * n, "text-anchor": "end" };
      const key = svg("text", at, curve.name);
      key.style.fill = "";
      plot.append(key);
    });
    this.cursor = svg("line", { class: "cursor", y1: PLOT.top, y2: PLOT.top + inner[1], visibility: "hidden" });
    plot.append(this.cursor);
    this.describe();
    this.csv();
  }

  axes(low, high, y, inner) {
    const { plot } = this;
    const [bottom, right] = [PLOT.top + inner[1], PLOT.left + inner[0]];
    const rows = ticks(low, high, 4);
    const columns = ticks(0, this.length, Math.max(3, inner[0] / 110));
    const step = (list) => (list.length > 1 ? list[1] - list[0] : Math.abs(list[0]) || 1);
    for (const value of rows) {
      plot.append(svg("line", { class: "grid", x1: PLOT.left, x2: right, y1: y(value), y2: y(value) }));
      plot.append(svg("text", { class: "tick-y", x: PLOT.left - 6, y: y(value) + 4, "text-anchor": "end" }, tickText(value, step(rows))));
    }
    for (const value of columns) {
      const x = this.x(value);
      plot.append(svg("line", { class: "axis", x1: x, x2: x, y1: bottom, y2: bottom + 4 }));
      plot.append(svg("text", { class: "tick-x", x, y: bottom + 17, "text-anchor": "middle" }, tickText(value, step(columns))));
    }
    plot.append(svg("path", { class: "axis", d: `M${PLOT.left} ${PLOT.top}V${bottom}H${right}` }));
    const middle = PLOT.left + inner[0] / 2;
    plot.append(svg("text", { class: "label-x", x: middle, y: bottom + 33, "text-anchor": "middle" }, `distance (${HEADER.unit})`));
    const turned = `translate(14 ${PLOT.top + inner[1] / 2}) rotate(-90)`;
    plot.append(svg("text", { class: "label-y", transform: turned, "text-anchor": "middle" }, shortQuantity(this.curves[0].quantity)));
  }

  describe() {
    const [a, b] = this.line.map((p) => p.map((v) => v.toFixed(3)).join(", "));
    const text = `from ${a} to ${b} ${HEADER.unit}: ${digits(this.length)} ${HEADER.unit} long`;
    document.getElementById("profile-text").textContent = text;
  }

  csv() {
    const names = this.curves.map((c) => `"${c.name}, ${c.quantity}"`);
    const rows = this.distances.map((d, k) => [d.toPrecision(8), ...this.curves.map((c) => c.values[k].toPrecision(8))].join(","));
    const text = [`"distance (${HEADER.unit})",${names.join(",")}`, ...rows].join("\n");
    document.getElementById("profile-csv").href = "data:text/csv;charset=utf-8," + encodeURIComponent(text + "\n");
  }

  /** Reads the curves at the pointer. */
  point(event) {
    if (!this.curves) return;
    const inner = this.plot.clientWidth - PLOT.left - PLOT.right;
    const part = Math.min(Math.max((event.offsetX - PLOT.left) / inner, 0), 1);
    this.marked = Math.round(part * (this.distances.length - 1));
    this.mark();
  }

  mark() {
    if (!this.curves) return;
    if (this.marked === null) {
      this.cursor.setAttribute("visibility", "hidden");
      this.describe();
    } else {
      const distance = this.distances[this.marked];
      for (const end of ["x1", "x2"]) this.cursor.setAttribute(end, this.x(distance));
      this.cursor.setAttribute("visibility", "visible");
      const values = this.curves.map((c) => `${c.name} ${digits(c.values[this.marked])}`).join(", ");
      document.getElementById("profile-text").textContent = `at ${digits(distance)} ${HEADER.unit}: ${values}`;
    }
    this.changed();
  }

  /** Draws the line over the image. */
  drawLine(context, view) {
    if (!this.line) return;
    const [from, to] = this.line.map((p) => view.toScreen(...p));
    context.save();
    context.scale(view.ratio, view.ratio);
    for (const [width, color] of [[4, "rgb(0 0 0 / .6)"], [1.8, "#fff"]]) {
      context.lineWidth = width;
      context.strokeStyle = context.fillStyle = color;
      context.beginPath();
      context.moveTo(...from);
      context.lineTo(...to);
      context.stroke();
      const dots = this.marked === null || !this.curves ? [from, to] : [from, to, this.markedPoint(from, to)];
      for (const dot of dots) {
        context.beginPath();
        context.arc(...dot, width + 1.5, 0, 2 * Math.PI);
        context.fill();
      }
    }
    context.restore();
  }

  markedPoint(from, to) {
    const part = this.distances[this.marked] / this.length;
    return [from[0] + (to[0] - from[0]) * part, from[1] + (to[1] - from[1]) * part];
  }
}

/** `fraction of the incident beam` is too long for the side of a plot. */
function shortQuantity(quantity) {
  return quantity.replace("fraction of the incident beam", "fraction of beam").replace(/;.*/, "");
}
