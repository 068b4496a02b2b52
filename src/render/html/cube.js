// Patterns of a scan: the image of a detector on the left, a diffraction pattern with the detector on the right.

const [COLUMNS, ROWS] = HEADER.scan;
const PIXELS = HEADER.pixels;
const SIZE = PIXELS * PIXELS;
/** Angle of the middle of a pixel along an axis, in mrad. */
const angle = (i) => HEADER.first + i * HEADER.pixel;
/** The largest angle that a whole ring on the axis has on the detector. */
const MOST_MRAD = Math.min(-angle(-0.5), angle(PIXELS - 0.5));
/** Parts of a pixel along an axis that are on the detector or not. */
const PARTS = 8;
/** A ring or the centre is caught within so many CSS pixels. */
const CATCH_PX = 9;

/** Intensities [row of the scan, column, ky, kx]. */
const cube = new Float32Array(ROWS * COLUMNS * SIZE);
const mean = new Float32Array(SIZE);
const centre = { x: new Float32Array(ROWS * COLUMNS), y: new Float32Array(ROWS * COLUMNS) };

const IMAGES = {
  detector: "detector",
  com_x: "centre of mass, x",
  com_y: "centre of mass, y",
};

const shown = {
  image: "detector",
  values: new Float32Array(ROWS * COLUMNS),
  probe: [COLUMNS >> 1, ROWS >> 1],
  held: false,
  /** Pixel of the pattern under the pointer. */
  pixel: null,
  detector: { x: 0, y: 0, inner: 0, outer: Math.min(HEADER.semiangle, MOST_MRAD) },
  /** Whether the detector has changed since its image was summed. */
  stale: true,
  rows: 0,
};

// ---- Values ------------------------------------------------------------------------------------

async function load() {
  const table = Float32Array.from({ length: 65536 }, (_, code) => HEADER.scale * (HEADER.square ? code * code : code));
  for (let row = 0; row < ROWS; row++) {
    const codes = await blob16(row);
    if (codes.length !== COLUMNS * SIZE) throw new Error(CUT);
    const first = row * codes.length;
    for (let i = 0; i < codes.length; i++) cube[first + i] = table[codes[i]];
    for (let column = 0; column < COLUMNS; column++) addProbe(row * COLUMNS + column);
    shown.rows = row + 1;
    shown.stale = true;
    redraw();
  }
}

/** Adds a pattern to the mean, and takes its centre of mass. */
function addProbe(probe) {
  const first = probe * SIZE;
  let [sum, x, y] = [0, 0, 0];
  for (let ky = 0; ky < PIXELS; ky++) {
    for (let kx = 0; kx < PIXELS; kx++) {
      const value = cube[first + ky * PIXELS + kx];
      mean[ky * PIXELS + kx] += value / (ROWS * COLUMNS);
      sum += value;
      x += value * angle(kx);
      y += value * angle(ky);
    }
  }
  centre.x[probe] = sum > 0 ? x / sum : 0;
  centre.y[probe] = sum > 0 ? y / sum : 0;
}

/** The pixels on the detector, with the share of their area that is. */
function detectorPixels({ x, y, inner, outer }) {
  const [pixels, shares] = [[], []];
  const half = HEADER.pixel / Math.SQRT2;
  for (let ky = 0; ky < PIXELS; ky++) {
    for (let kx = 0; kx < PIXELS; kx++) {
      const [dx, dy] = [angle(kx) - x, angle(ky) - y];
      const middle = Math.hypot(dx, dy);
      if (middle > outer + half || middle < inner - half) continue;
      let inside = PARTS * PARTS;
      if (middle > outer - half || middle < inner + half) {
        inside = 0;
        for (let part = 0; part < PARTS * PARTS; part++) {
          const u = dx + HEADER.pixel * (((part % PARTS) + 0.5) / PARTS - 0.5);
          const v = dy + HEADER.pixel * ((Math.floor(part / PARTS) + 0.5) / PARTS - 0.5);
          const r = Math.hypot(u, v);
          if (r >= inner && r < outer) inside++;
        }
      }
      if (inside === 0) continue;
      pixels.push(ky * PIXELS + kx);
      shares.push(inside / (PARTS * PARTS));
    }
  }
  return [Int32Array.from(pixels), Float32Array.from(shares)];
}

/** Sums every pattern over the detector. */
function sumImage() {
  if (shown.image !== "detector") {
    shown.values = shown.image === "com_x" ? centre.x : centre.y;
    return;
  }
  const [pixels, shares] = detectorPixels(shown.detector);
  const values = new Float32Array(ROWS * COLUMNS);
  for (let probe = 0; probe < shown.rows * COLUMNS; probe++) {
    const first = probe * SIZE;
    let sum = 0;
    for (let i = 0; i < pixels.length; i++) sum += shares[i] * cube[first + pixels[i]];
    values[probe] = sum;
  }
  shown.values = values;
}

function currentPattern() {
  if ($("pattern-choice").value === "mean") return mean;
  const first = (shown.probe[1] * COLUMNS + shown.probe[0]) * SIZE;
  return cube.subarray(first, first + SIZE);
}

// ---- Drawing -----------------------------------------------------------------------------------

/** A canvas that shows cells of one size, as large as they fit. */
class Panel {
  constructor(canvas, columns, rows, aspect) {
    Object.assign(this, { canvas, columns, rows, aspect });
    this.context = canvas.getContext("2d");
    this.cells = document.createElement("canvas");
    [this.cells.width, this.cells.height] = [columns, rows];
    this.resize();
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas;
    this.ratio = window.devicePixelRatio || 1;
    [this.canvas.width, this.canvas.height] = [clientWidth, clientHeight].map((n) => Math.max(1, Math.round(n * this.ratio)));
    this.width = Math.max(1, Math.min(clientWidth, clientHeight * this.aspect));
    this.height = this.width / this.aspect;
  }

  /** CSS pixels of a place in cells; cell (0, 0) begins at (0, 0). */
  toScreen(x, y) {
    return [(x / this.columns) * this.width, (y / this.rows) * this.height];
  }

  toCells(px, py) {
    return [(px / this.width) * this.columns, (py / this.height) * this.rows];
  }

  /** The cell at a place of the screen, or null. */
  cell(px, py) {
    const [x, y] = this.toCells(px, py).map(Math.floor);
    return x >= 0 && y >= 0 && x < this.columns && y < this.rows ? [x, y] : null;
  }

  /** Draws values from 0, the first colour, to 1, the last. */
  draw(part, map) {
    const context = this.cells.getContext("2d");
    const image = context.createImageData(this.columns, this.rows);
    const colors = new Uint32Array(image.data.buffer);
    for (let i = 0; i < colors.length; i++) colors[i] = map[Math.round(255 * Math.min(Math.max(part(i), 0), 1))];
    context.putImageData(image, 0, 0);
    this.context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    this.context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this.context.imageSmoothingEnabled = false;
    this.context.drawImage(this.cells, 0, 0, this.width, this.height);
  }
}

const scan = new Panel($("scan"), COLUMNS, ROWS, (COLUMNS * HEADER.step[0]) / (ROWS * HEADER.step[1]));
const pattern = new Panel($("pattern"), PIXELS, PIXELS, 1);

function drawScan(map) {
  const values = shown.values;
  let [low, high] = [Infinity, -Infinity];
  for (let i = 0; i < shown.rows * COLUMNS; i++) [low, high] = [Math.min(low, values[i]), Math.max(high, values[i])];
  scan.draw((i) => (high > low ? (values[i] - low) / (high - low) : 0.5), map);
  const unit = shown.image === "detector" ? HEADER.quantity : "mrad";
  $("scan-caption").textContent = `${IMAGES[shown.image]}: ${digits(low, 3)} to ${digits(high, 3)} ${unit}`;
  const [x, y] = scan.toScreen(shown.probe[0], shown.probe[1]);
  const [w, h] = scan.toScreen(1, 1);
  outline(scan.context, (path) => path.rect(x - 1, y - 1, w + 2, h + 2));
}

function drawPattern(map) {
  const values = currentPattern();
  const most = values.reduce((a, b) => Math.max(a, b), 0);
  const power = Number($("power").value);
  // Six decades.
  const part = power > 0 ? (v) => (v / most) ** power : (v) => 1 + Math.log10(Math.max(v / most, 1e-6)) / 6;
  pattern.draw((i) => (most > 0 ? part(values[i]) : 0), map);
  const of = values === mean ? "mean pattern" : `pattern of probe ${shown.probe.join(", ")}`;
  $("pattern-caption").textContent = `${of}, to ${digits(MOST_MRAD, 3)} mrad; largest ${digits(most, 3)} ${HEADER.quantity}`;
  const { x, y, inner, outer } = shown.detector;
  const [cx, cy] = placeOf(x, y);
  const circle = (mrad) => (path) => path.arc(cx, cy, mrad * mradPx(), 0, 2 * Math.PI);
  outline(pattern.context, circle(outer));
  if (inner > 0) outline(pattern.context, circle(inner));
  outline(pattern.context, (path) => {
    path.moveTo(cx - 6, cy); path.lineTo(cx + 6, cy); path.moveTo(cx, cy - 6); path.lineTo(cx, cy + 6);
  });
}

/** Draws a line that is seen on light and on dark. */
function outline(context, draw) {
  for (const [width, color] of [[3.5, "rgb(0 0 0 / .6)"], [1.5, "#ffd166"]]) {
    context.beginPath();
    draw(context);
    context.lineWidth = width;
    context.strokeStyle = color;
    context.stroke();
  }
}

/** CSS pixels of an angle (x, y) in mrad on the pattern, and of one mrad. */
const placeOf = (x, y) => pattern.toScreen(...[x, y].map((mrad) => (mrad - angle(-0.5)) / HEADER.pixel));
const anglesAt = (px, py) => pattern.toCells(px, py).map((cell) => angle(cell - 0.5));
const mradPx = () => pattern.width / (PIXELS * HEADER.pixel);

let scheduled = false;

function redraw() {
  if (scheduled) return;
  scheduled = true;
  root.dataset.state = "busy";
  requestAnimationFrame(() => {
    scheduled = false;
    if (shown.stale) sumImage();
    shown.stale = false;
    const map = MAPS[$("colormap").value];
    drawScan(map);
    drawPattern(map);
    updateReadout();
    if (!scheduled && shown.rows === ROWS) root.dataset.state = "still";
  });
}

// ---- Readout -----------------------------------------------------------------------------------

function list(element, rows) {
  element.replaceChildren(...rows.flatMap(([name, text, value, key]) => {
    const [term, what] = [document.createElement("dt"), document.createElement("dd")];
    term.textContent = name;
    what.textContent = text;
    what.dataset.key = key ?? name;
    what.dataset.value = value ?? text;
    return [term, what];
  }));
}

function updateReadout() {
  const [x, y] = shown.probe;
  const value = shown.values[y * COLUMNS + x];
  const at = [x, y].map((n, k) => HEADER.origin[k] + n * HEADER.step[k]);
  const unit = shown.image === "detector" ? HEADER.quantity : "mrad";
  const rows = [
    ["probe", `column ${x}, row ${y}`, `${x} ${y}`],
    ["position", `${at.map((v) => v.toFixed(2)).join(", ")} Å`, at.join(" ")],
    [IMAGES[shown.image], `${digits(value)} ${unit}`, value, "value"],
  ];
  if (shown.pixel) {
    const [kx, ky] = shown.pixel;
    const angles = [angle(kx), angle(ky)];
    const intensity = currentPattern()[ky * PIXELS + kx];
    rows.push(
      ["angle", `${angles.map((v) => v.toFixed(1)).join(", ")} (${Math.hypot(...angles).toFixed(1)}) mrad`, angles.join(" ")],
      ["intensity", `${digits(intensity)} ${HEADER.quantity}`, intensity],
    );
  }
  list($("readout"), rows);
  $("pinned").hidden = !shown.held;
  const { x: dx, y: dy, inner, outer } = shown.detector;
  list($("detector"), [
    ["angles", `${digits(inner, 3)} to ${digits(outer, 3)} mrad`, `${inner} ${outer}`],
    ["centre", `${dx.toFixed(1)}, ${dy.toFixed(1)} mrad`, `${dx} ${dy}`],
  ]);
  for (const [id, mrad] of [["inner", inner], ["outer", outer]]) {
    if (document.activeElement !== $(id)) $(id).value = Number(mrad.toFixed(2));
  }
}

// ---- Controls ----------------------------------------------------------------------------------

function setDetector(change) {
  const detector = { ...shown.detector, ...change };
  detector.outer = Math.max(detector.outer, 0.1 * HEADER.pixel);
  detector.inner = Math.min(Math.max(detector.inner, 0), detector.outer);
  shown.detector = detector;
  shown.image = $("image").value = "detector";
  shown.stale = true;
  redraw();
}

function chooseImage(name) {
  shown.image = $("image").value = name;
  shown.stale = true;
  redraw();
}

function moveProbe(dx, dy) {
  const [x, y] = shown.probe;
  shown.probe = [Math.min(Math.max(x + dx, 0), COLUMNS - 1), Math.min(Math.max(y + dy, 0), ROWS - 1)];
  shown.held = true;
  $("pattern-choice").value = "probe";
}

const place = (event) => {
  const { left, top } = event.currentTarget.getBoundingClientRect();
  return [event.clientX - left, event.clientY - top];
};

function watchScan() {
  const choose = (event, click) => {
    const cell = scan.cell(...place(event));
    if (!cell || (shown.held && !click)) return;
    if (click) shown.held = !(shown.held && String(cell) === String(shown.probe));
    shown.probe = cell;
    $("pattern-choice").value = "probe";
    redraw();
  };
  $("scan").addEventListener("pointermove", (event) => choose(event, false));
  $("scan").addEventListener("pointerdown", (event) => choose(event, true));
}

/** What a drag that begins here changes. */
function grip(px, py) {
  const { x, y, inner, outer } = shown.detector;
  const [cx, cy] = placeOf(x, y);
  const distance = Math.hypot(px - cx, py - cy);
  const off = (mrad) => Math.abs(distance - mrad * mradPx());
  if (off(outer) <= CATCH_PX && off(outer) <= off(inner)) return "outer";
  if (inner > 0 && off(inner) <= CATCH_PX) return "inner";
  return distance <= CATCH_PX ? "centre" : "new";
}

function watchPattern() {
  const canvas = $("pattern");
  let held = null;
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    held = grip(...place(event));
    if (held === "new") held = { at: anglesAt(...place(event)) };
  });
  canvas.addEventListener("pointermove", (event) => {
    const at = place(event);
    shown.pixel = pattern.cell(...at);
    canvas.style.cursor = { outer: "ew-resize", inner: "ew-resize", centre: "move" }[held ?? grip(...at)] ?? "crosshair";
    const [x, y] = anglesAt(...at);
    const { x: cx, y: cy } = shown.detector;
    if (held === "outer" || held === "inner") setDetector({ [held]: Math.hypot(x - cx, y - cy) });
    else if (held === "centre") setDetector({ x, y });
    else if (held) setDetector({ x: held.at[0], y: held.at[1], inner: 0, outer: Math.hypot(x - held.at[0], y - held.at[1]) });
    redraw();
  });
  const release = () => { held = null; };
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);
  canvas.addEventListener("pointerleave", () => { shown.pixel = null; redraw(); });
}

/** Detectors that are usual for a probe of this semiangle, where the pattern is wide enough. */
function usualDetectors() {
  const a = HEADER.semiangle;
  const all = [["BF", 0, a], ["ABF", a / 2, a], ["ADF", 2 * a, MOST_MRAD]];
  return all.filter(([, inner, outer]) => outer <= MOST_MRAD && inner < outer);
}

function next(select) {
  const element = $(select);
  element.selectedIndex = (element.selectedIndex + 1) % element.options.length;
  element.dispatchEvent(new Event("change"));
}

const KEYS = {
  ArrowLeft: () => moveProbe(-1, 0),
  ArrowRight: () => moveProbe(1, 0),
  ArrowUp: () => moveProbe(0, -1),
  ArrowDown: () => moveProbe(0, 1),
  Escape: () => { shown.held = false; },
  p: () => next("pattern-choice"),
  n: () => next("image"),
  m: () => next("colormap"),
  r: () => setDetector({ x: 0, y: 0 }),
  "?": () => $("help").showModal(),
};

function connect() {
  for (const [name, text] of Object.entries(IMAGES)) $("image").add(new Option(text, name));
  for (const name of Object.keys(MAPS)) $("colormap").add(new Option(name, name));
  for (const [name, inner, outer] of usualDetectors()) {
    const button = document.createElement("button");
    button.id = `usual-${name}`;
    button.textContent = name;
    button.title = `${digits(inner, 3)} to ${digits(outer, 3)} mrad`;
    button.addEventListener("click", () => setDetector({ x: 0, y: 0, inner, outer }));
    $("usual").append(button);
  }
  list($("facts"), HEADER.note ? [...HEADER.facts, ["reduced", HEADER.note]] : HEADER.facts);
  $("image").addEventListener("change", () => chooseImage($("image").value));
  for (const id of ["pattern-choice", "power", "colormap"]) $(id).addEventListener("change", redraw);
  for (const id of ["inner", "outer"]) {
    $(id).addEventListener("change", () => {
      const mrad = $(id).valueAsNumber;
      if (Number.isFinite(mrad)) setDetector({ [id]: mrad });
    });
  }
  $("theme").addEventListener("click", switchTheme);
  $("help-button").addEventListener("click", KEYS["?"]);
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches("input, select")) return;
    const action = KEYS[event.key] ?? KEYS[event.key.toLowerCase()];
    if (!action || $("help").open) return;
    event.preventDefault();
    action();
    redraw();
  });
  watchScan();
  watchPattern();
  const sizes = new ResizeObserver(() => { scan.resize(); pattern.resize(); redraw(); });
  [scan, pattern].forEach((panel) => sizes.observe(panel.canvas));
}

async function open() {
  connect();
  redraw();
  await load();
}

start(open);
