// Puts the page together: controls, keys, and the loop that draws.

const [COLUMNS_PX, ROWS_PX] = HEADER.size;
/** Edges of the image; pixel (0, 0) is centred on the origin. */
const BOUNDS = [
  HEADER.origin[0] - HEADER.pixel[0] / 2, HEADER.origin[1] - HEADER.pixel[1] / 2,
  HEADER.origin[0] + (COLUMNS_PX - 0.5) * HEADER.pixel[0], HEADER.origin[1] + (ROWS_PX - 0.5) * HEADER.pixel[1],
];

const images = HEADER.images.map((image) => Object.assign(image, { pyramid: new Pyramid(image.levels) }));
const columns = HEADER.columns ? new Columns(HEADER.columns) : null;
const phases = HEADER.phases ? new Pyramid(HEADER.phases.levels) : null;
const overlays = new Overlays(columns, phases, BOUNDS);
const readout = new Readout(columns, phases, images);
const profile = new Profile(() => redraw());
const canvas = $("field");
const context = canvas.getContext("2d", { alpha: false });
const view = new View(canvas, BOUNDS, Math.min(...HEADER.pixel));
const names = [...new Set(images.map((image) => image.name))];

const shown = {
  image: images[HEADER.start.image],
  colormap: HEADER.start.colormap,
  contrast: HEADER.start.contrast,
  /** Limits that are kept, or null. */
  locked: null,
  limits: [0, 1],
  /** Whether what lies between pixels is interpolated: simulated images are, counted electrons are not. */
  smooth: !HEADER.world_tile,
  style: {},
};

// ---- Colours -----------------------------------------------------------------------------------

/** Gives every level of the shown image that has its table the colours of its values. */
function color() {
  const { image, locked } = shown;
  const map = MAPS[shown.colormap];
  image.levels.forEach((level, k) => {
    if (!level.values) return;
    const limits = locked ? locked.map((v) => (v - image.offset) / image.scale) : image.pyramid.percentiles(k, shown.contrast);
    const [low, high] = (level.limits = limits);
    const colorOf = (value) => {
      const part = high > low ? (value - low) / (high - low) : 0.5;
      return map[Math.round(Math.min(Math.max(part, 0), 1) * 255)];
    };
    image.pyramid.setColors(k, Uint32Array.from(level.values, colorOf));
    if (k === 0) image.pyramid.setEnlargement(shown.smooth ? enlargement(HEADER.size) : 1, colorOf);
  });
  redraw();
}

async function openImage(image) {
  await image.pyramid.open(1);
  if (image === shown.image) color();
  await image.pyramid.open();
  if (image === shown.image) color();
}

// Whether images have the same place in their series.
function isBeside(a, b) {
  return a.thickness === b.thickness && a.number === b.number;
}

function choose(image) {
  shown.image = image;
  $("image").value = image.name;
  const series = images.filter((other) => other.name === image.name);
  $("series").hidden = series.length < 2;
  $("thickness").max = series.length - 1;
  $("thickness").value = series.indexOf(image);
  $("series-name").textContent = image.number === null ? "thickness" : "number";
  if (image.number !== null) $("thickness-value").textContent = `${image.number} of 0 to ${series.length - 1}`;
  if (image.thickness !== null) $("thickness-value").textContent = `${image.thickness.toFixed(2)} ${HEADER.unit}`;
  openImage(image).catch((error) => complain(error.message));
  replot();
  redraw();
}

function chooseThickness(index) {
  const series = images.filter((image) => image.name === shown.image.name);
  choose(series[Math.min(Math.max(index, 0), series.length - 1)]);
}

function nextImage() {
  const next = names[(names.indexOf(shown.image.name) + 1) % names.length];
  const alike = (image) => image.name === next && isBeside(image, shown.image);
  choose(images.find(alike) ?? images.find((image) => image.name === next));
}

// ---- Profile -----------------------------------------------------------------------------------

function replot() {
  if (!profile.line) return;
  const { image } = shown;
  const other = images.find((o) => o.name !== image.name && o.number === image.number && image.thickness === null && o.quantity === image.quantity);
  const [from, to] = profile.line;
  profile.show(from, to, other ? [image, other] : [image]).catch((error) => complain(error.message));
}

// ---- Drawing -----------------------------------------------------------------------------------

let frame = 0;
let scheduled = false;
let last = 0;
let before = [0, 0, 0];

function redraw() {
  if (scheduled) return;
  scheduled = true;
  root.dataset.state = "busy";
  requestAnimationFrame(draw);
}

function draw(now) {
  scheduled = false;
  frame++;
  const moving = view.step(Math.min(now - last, 50));
  last = now;
  const zooming = view.scale !== before[2];
  before = [view.x, view.y, view.scale];
  allowPainting();
  const complete = drawField(moving || zooming);
  readout.update(shown.image);
  drawRulers(context, view, shown.style);
  updateScaleBar(view);
  updateLegend();
  forgetWaiting((tile) => tile.used === frame || tile.wanted || tile.level === tile.owner.levels.length - 1);
  images.forEach((image) => image.pyramid.trim(frame));
  load();
  // Tiles that arrive draw again by themselves.
  if (moving || zooming || painting.late || (!complete && queue.running === 0 && !failed())) redraw();
  if (!scheduled && complete) {
    root.dataset.state = "still";
    mark("sharp");
  }
}

/** Draws image and overlays; returns whether nothing is missing. */
function drawField(moving) {
  const { image } = shown;
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.fillStyle = shown.style.outside;
  context.fillRect(0, 0, canvas.width, canvas.height);
  const place = (i, j) => view.toScreen(BOUNDS[0] + i * HEADER.pixel[0], BOUNDS[1] + j * HEADER.pixel[1]).map((v) => v * view.ratio);
  const part = view.seen().map((v, k) => (v - BOUNDS[k % 2]) / HEADER.pixel[k % 2]);
  const size = view.scale * view.ratio * Math.max(...HEADER.pixel);
  const level = image.pyramid.levelFor(size);
  context.save();
  context.beginPath();
  const [a, b] = [place(0, 0), place(COLUMNS_PX, ROWS_PX)].map((p) => p.map(Math.round));
  context.rect(a[0], a[1], b[0] - a[0], b[1] - a[1]);
  context.clip();
  context.imageSmoothingEnabled = size < 3 || shown.smooth;
  let complete = Boolean(image.pyramid.colors[level]) && image.pyramid.draw(context, level, part, place, frame);
  if (image.pyramid.colors.length > 0) mark("first-paint");
  complete = overlays.draw(context, view, moving, place, frame) && complete;
  context.restore();
  readout.draw(context, view);
  profile.drawLine(context, view);
  const limits = image.levels[level].limits;
  if (limits && String([limits, shown.colormap, image.name]) !== shown.bar) {
    shown.bar = String([limits, shown.colormap, image.name]);
    shown.limits = limits;
    updateColorBar(MAPS[shown.colormap], limits, image);
  }
  return complete;
}

const marks = new Set();
/** Notes when something happened first. */
function mark(name) {
  if (marks.has(name)) return;
  marks.add(name);
  performance.mark("stemgen-" + name);
}

function updateLegend() {
  const lines = overlays.legend(view);
  const text = JSON.stringify(lines);
  if (text === shown.legend) return;
  shown.legend = text;
  $("legend-section").hidden = lines.length === 0;
  const shapes = {
    ring: (color) => `<circle cx="8" cy="8" r="5" fill="none" stroke="${color}" stroke-width="2.5"/>`,
    line: (color) => `<path d="M1 8h14" stroke="${color}" stroke-width="3"/>`,
    area: (color) => `<rect x="2" y="2" width="12" height="12" fill="${color}"/>`,
  };
  $("legend").replaceChildren(...lines.map(([shape, color, label]) => {
    const item = document.createElement("li");
    item.innerHTML = `<svg viewBox="0 0 16 16" aria-hidden="true">${shapes[shape](css(color))}</svg>`;
    item.append(label);
    return item;
  }));
}

// ---- Controls ----------------------------------------------------------------------------------

function readStyle() {
  const style = getComputedStyle(root);
  for (const name of ["panel", "ink", "outside"]) shown.style[name] = style.getPropertyValue("--" + name).trim();
  redraw();
}

function toggleTheme() {
  switchTheme();
  readStyle();
}

function toggleOverlay(name, on = !overlays.shown.has(name)) {
  if (!overlays.available.includes(name)) return;
  overlays.shown[on ? "add" : "delete"](name);
  $("overlay-" + name).setAttribute("aria-pressed", on);
  redraw();
}

function setProfileMode(on) {
  $("profile-mode").setAttribute("aria-pressed", on);
}

const profileMode = () => $("profile-mode").getAttribute("aria-pressed") === "true";

function chooseColormap(name) {
  shown.colormap = $("colormap").value = name;
  color();
}

function fillControls() {
  const option = (name) => Object.assign(document.createElement("option"), { textContent: name });
  $("image").append(...names.map(option));
  $("image-choice").hidden = names.length < 2;
  $("colormap").append(...HEADER.colormaps.map(([name]) => option(name)));
  $("colormap").value = shown.colormap;
  [$("low").value, $("high").value] = shown.contrast;
  overlays.available.forEach((name, k) => {
    const button = Object.assign(document.createElement("button"), { id: "overlay-" + name, textContent: name });
    button.title = `show ${name} (${k + 1})`;
    button.setAttribute("aria-pressed", "false");
    button.addEventListener("click", () => toggleOverlay(name));
    $("overlays").append(button);
  });
  $("facts").append(...HEADER.facts.flatMap(([name, text]) => [
    Object.assign(document.createElement("dt"), { textContent: name }),
    Object.assign(document.createElement("dd"), { textContent: text }),
  ]));
}

function connectControls() {
  $("image").addEventListener("change", (event) => {
    const name = event.target.value;
    const alike = (image) => image.name === name && isBeside(image, shown.image);
    choose(images.find(alike) ?? images.find((image) => image.name === name));
  });
  $("thickness").addEventListener("input", (event) => chooseThickness(Number(event.target.value)));
  $("colormap").addEventListener("change", (event) => chooseColormap(event.target.value));
  for (const id of ["low", "high"]) $(id).addEventListener("change", () => {
    const [low, high] = [Number($("low").value), Number($("high").value)];
    const good = low >= 0 && low < high && high <= 100;
    $(id).setCustomValidity(good ? "" : "the percentages must rise, from 0 to 100");
    if (!good) return $(id).reportValidity();
    shown.contrast = [low, high];
    color();
  });
  $("smooth").checked = shown.smooth;
  $("smooth").addEventListener("change", (event) => {
    shown.smooth = event.target.checked;
    color();
  });
  $("lock").addEventListener("change", (event) => {
    const { image, limits } = shown;
    shown.locked = event.target.checked ? limits.map((v) => v * image.scale + image.offset) : null;
    color();
  });
  $("profile-mode").addEventListener("click", () => setProfileMode(!profileMode()));
  $("profile-close").addEventListener("click", () => profile.close());
  $("profile-width").addEventListener("change", replot);
  $("zoom-in").addEventListener("click", () => { view.zoom(1.6); redraw(); });
  $("zoom-out").addEventListener("click", () => { view.zoom(1 / 1.6); redraw(); });
  $("fit").addEventListener("click", fit);
  $("theme").addEventListener("click", toggleTheme);
  $("help-button").addEventListener("click", () => $("help").showModal());
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", readStyle);
  window.addEventListener("resize", resized);
  new ResizeObserver(resized).observe($("stage"));
}

function fit() {
  view.show(BOUNDS);
  redraw();
}

function resized() {
  view.resize();
  if (profile.curves) profile.draw();
  redraw();
}

/** Keys and what they do. */
const KEYS = {
  ArrowLeft: () => view.glide(-0.15, 0),
  ArrowRight: () => view.glide(0.15, 0),
  ArrowUp: () => view.glide(0, -0.15),
  ArrowDown: () => view.glide(0, 0.15),
  "+": () => view.zoom(1.6),
  "=": () => view.zoom(1.6),
  "-": () => view.zoom(1 / 1.6),
  0: fit,
  Home: fit,
  l: () => setProfileMode(!profileMode()),
  m: () => chooseColormap(HEADER.colormaps[(HEADER.colormaps.findIndex(([n]) => n === shown.colormap) + 1) % HEADER.colormaps.length][0]),
  n: nextImage,
  "[": () => chooseThickness(Number($("thickness").value) - 1),
  "]": () => chooseThickness(Number($("thickness").value) + 1),
  "?": () => $("help").showModal(),
  Escape: () => {
    if (readout.held) readout.hold(null);
    else profile.close();
  },
};

window.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || $("help").open) return;
  // These take keys themselves.
  if (event.target.matches("input[type=number], input[type=range], select")) return;
  const overlay = overlays.available[Number(event.key) - 1];
  const action = overlay ? () => toggleOverlay(overlay) : KEYS[event.key] ?? KEYS[event.key.toLowerCase()];
  if (!action) return;
  event.preventDefault();
  action();
  redraw();
});

listen(view, {
  changed: redraw,
  hover(point) {
    readout.at = point ? view.toField(...point) : null;
    redraw();
  },
  click(point) {
    const position = view.toField(...point);
    readout.at = position;
    readout.hold(readout.held ? null : position);
  },
  drawsLines: (event) => event.shiftKey || profileMode(),
  line(from, to, finished) {
    profile.line = [view.toField(...from), view.toField(...to)];
    if (finished) replot();
  },
});

// ---- Opening -----------------------------------------------------------------------------------

async function open() {
  fillControls();
  connectControls();
  const { overlays: asked } = HEADER.start;
  (asked.length > 0 ? asked : overlays.usual).forEach((name) => toggleOverlay(name, true));
  if (HEADER.start.region) view.show(HEADER.start.region);
  readStyle();
  queue.arrived = redraw;
  choose(shown.image);
  if (phases) {
    await phases.open();
    phases.levels.forEach((level, k) => phases.setColors(k, Uint32Array.from(level.values, (code) => (
      code > 0 ? packed(COLORS.phases[(code - 1) % 5], Math.round(255 * WASH)) : 0
    ))));
    redraw();
  }
  if (columns) {
    await columns.open();
    mark("truth");
    redraw();
  }
  for (const image of images) await image.pyramid.open();
}

start(open);
