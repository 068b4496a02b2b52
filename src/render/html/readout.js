// What lies under the pointer.

/** A column's intensity is the mean over pixels whose centres lie within so many nm of it. */
const COLUMN_RADIUS = 0.06;
/** A column is under the pointer up to so many nm away. */
const COLUMN_REACH = 0.15;

/** The pixel at a position on the axes. */
function pixelAt([x, y]) {
  return [x, y].map((v, k) => Math.floor((v - HEADER.origin[k]) / HEADER.pixel[k] + 0.5));
}

/** Mean of the pixels within a radius; undefined while some of them are missing. */
function discMean(pyramid, [x, y], radius) {
  const [columns, rows] = HEADER.size;
  const centre = [x, y].map((v, k) => (v - HEADER.origin[k]) / HEADER.pixel[k]);
  const reach = HEADER.pixel.map((p) => radius / p);
  let [sum, count] = [0, 0];
  for (let j = Math.ceil(centre[1] - reach[1]); j <= centre[1] + reach[1]; j++) {
    for (let i = Math.ceil(centre[0] - reach[0]); i <= centre[0] + reach[0]; i++) {
      const distance = Math.hypot((i - centre[0]) / reach[0], (j - centre[1]) / reach[1]);
      if (i < 0 || j < 0 || i >= columns || j >= rows || distance > 1) continue;
      const value = pyramid.value(i, j);
      if (value === undefined) return undefined;
      sum += value;
      count++;
    }
  }
  return count > 0 ? sum / count : undefined;
}

class Readout {
  constructor(columns, phases, images) {
    Object.assign(this, { columns, phases, images });
    this.list = document.getElementById("readout");
    this.at = null;
    this.held = null;
  }

  /** Position that is read out. */
  get position() {
    return this.held ?? this.at;
  }

  hold(position) {
    this.held = position;
    document.getElementById("pinned").hidden = position === null;
  }

  /** The column there; -1 for none. */
  get column() {
    if (!this.position || !this.columns?.loaded) return -1;
    return this.columns.nearest(...this.position, COLUMN_REACH);
  }

  /** Writes the list; `image` is the one that is shown. */
  update(image) {
    const lines = this.position ? this.lines(image) : [];
    if (lines.length > 0) this.list.classList.add("used");
    this.list.replaceChildren(...lines.flatMap(([key, name, text, value]) => {
      const dt = Object.assign(document.createElement("dt"), { textContent: name });
      const dd = Object.assign(document.createElement("dd"), { textContent: text });
      dd.dataset.key = key;
      if (value !== undefined) dd.dataset.value = value;
      // Long lists have a line of their own.
      for (const part of [dt, dd]) part.classList.toggle("wide", key === "depths");
      return [dt, dd];
    }));
  }

  lines(image) {
    const { unit, size } = HEADER;
    const position = this.position;
    const [i, j] = pixelAt(position);
    const lines = [["position", `x, y (${unit})`, position.map((v) => v.toFixed(3)).join(", "), position.join(" ")]];
    if (i < 0 || j < 0 || i >= size[0] || j >= size[1]) return [...lines, ["outside", "", "outside the image"]];
    lines.push(["pixel", "column, row", `${i}, ${j}`, `${i} ${j}`]);
    if (HEADER.world_tile) lines.push(["tile", "tile", this.tile(i, j)]);
    this.addIntensity(lines, image, i, j);
    this.addPlace(lines, i, j);
    this.addColumn(lines, image);
    return lines;
  }

  tile(i, j) {
    const [edge, stride] = HEADER.world_tile;
    const number = (v, k) => Math.max(0, Math.min(Math.floor(v / stride), Math.ceil((HEADER.size[k] - edge) / stride)));
    return `${number(j, 1)}_${number(i, 0)}`;
  }

  addIntensity(lines, image, i, j) {
    const waiting = "...";
    const value = image.pyramid.value(i, j);
    const shown = value === undefined ? undefined : value * image.scale + image.offset;
    lines.push(["intensity", "intensity", shown === undefined ? waiting : digits(shown), shown]);
    if (image.stored) lines.push(["stored", "in the file", value === undefined ? waiting : digits(value), value]);
    if (image.electrons && shown !== undefined) {
      const count = shown * image.electrons;
      const whole = Math.abs(count - Math.round(count)) < 0.02;
      lines.push(["electrons", "electrons", whole ? String(Math.round(count)) : digits(count, 3), count]);
    }
    const other = this.images.find((o) => o.name !== image.name && o.number === image.number && o.thickness === null && o.quantity === image.quantity);
    if (other) {
      const there = other.pyramid.value(i, j);
      const text = there === undefined ? waiting : digits(there * other.scale + other.offset);
      lines.push(["other", other.name, text, there === undefined ? undefined : there * other.scale + other.offset]);
    }
  }

  addPlace(lines, i, j) {
    if (this.phases) {
      const code = this.phases.value(i, j);
      const text = code === undefined ? "..." : HEADER.phases.names[code] || `phase ${code}`;
      lines.push(["phase", "phase", text, code]);
    }
    const [x, y] = this.position;
    const inside = (p) => Math.hypot(x - p.centre[0], y - p.centre[1]) <= p.diameter / 2;
    HEADER.particles.filter(inside).forEach((p) => lines.push(["particle", "particle", p.text]));
  }

  addColumn(lines, image) {
    const index = this.column;
    if (index < 0) return;
    const at = [this.columns.x[index], this.columns.y[index]];
    const { sites, vacancies, substitutions, composition } = this.columns.contents(index);
    lines.push(["column", `column at (${HEADER.unit})`, at.map((v) => v.toFixed(3)).join(", "), at.join(" ")]);
    if (composition) lines.push(["composition", "atoms", composition]);
    lines.push(["sites", "sites", String(sites), sites]);
    lines.push(["vacancies", "vacancies", String(vacancies), vacancies]);
    lines.push(["substitutions", "substitutions", String(substitutions), substitutions]);
    const mean = discMean(image.pyramid, at, COLUMN_RADIUS);
    const shown = mean === undefined ? undefined : mean * image.scale + image.offset;
    const name = `mean to ${COLUMN_RADIUS} ${HEADER.unit}`;
    lines.push(["mean", name, shown === undefined ? "..." : digits(shown), shown]);
    const defects = this.columns.defects(index);
    for (const name of new Set(defects.map((d) => d.name))) {
      const depths = defects.filter((d) => d.name === name).map((d) => d.depth.toFixed(2));
      lines.push(["depths", `${name}: depth in ${HEADER.unit}`, depths.join(", ")]);
    }
  }

  /** Marks the column and the place that is held. */
  draw(context, view) {
    if (!this.position) return;
    context.save();
    context.scale(view.ratio, view.ratio);
    context.lineWidth = 2;
    const index = this.column;
    if (index >= 0) {
      context.strokeStyle = "#fff";
      context.shadowColor = "#000";
      context.shadowBlur = 3;
      context.beginPath();
      const radius = Math.max(1.25 * this.columns.ring * view.scale, 6);
      context.arc(...view.toScreen(this.columns.x[index], this.columns.y[index]), radius, 0, 2 * Math.PI);
      context.stroke();
    }
    if (this.held) {
      const [x, y] = view.toScreen(...this.held);
      context.strokeStyle = "#fff";
      context.beginPath();
      context.moveTo(x - 7, y); context.lineTo(x + 7, y);
      context.moveTo(x, y - 7); context.lineTo(x, y + 7);
      context.stroke();
    }
    context.restore();
  }
}
