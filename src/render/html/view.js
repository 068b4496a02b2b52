// Which part of the field is seen, and the gestures that change it.

/** Widths of the rulers at the left and below, in CSS pixels. */
const RULER = { left: 52, bottom: 24 };

class View {
  constructor(canvas, bounds, finest) {
    this.canvas = canvas;
    /** Left, upper, right and lower edge of the field. */
    this.bounds = bounds;
    /** Edge of a pixel in units of length. */
    this.finest = finest;
    this.goal = null;
    /** Whether the whole field is shown as large as it fits, also after the window has changed. */
    this.fitted = true;
    this.resize();
  }

  resize() {
    const { clientWidth, clientHeight } = this.canvas;
    this.width = Math.max(clientWidth, RULER.left + 20);
    this.height = Math.max(clientHeight, RULER.bottom + 20);
    this.ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(this.width * this.ratio);
    this.canvas.height = Math.round(this.height * this.ratio);
    /** Middle of what lies between the rulers. */
    this.middle = [(this.width + RULER.left) / 2, (this.height - RULER.bottom) / 2];
    if (this.fitted) this.show(this.bounds);
  }

  scaleToShow([x0, y0, x1, y1]) {
    const [width, height] = [this.width - RULER.left, this.height - RULER.bottom];
    return Math.min(width / (x1 - x0), height / (y1 - y0));
  }

  /** CSS pixels to a unit of length, at the most: 48 to a pixel, or more where the field fits with more. */
  get most() {
    return Math.max(48 / this.finest, this.scaleToShow(this.bounds));
  }

  get least() {
    return 0.5 * Math.min(this.scaleToShow(this.bounds), this.most);
  }

  /** Shows a part of the field. */
  show(part) {
    const [x0, y0, x1, y1] = part;
    this.x = (x0 + x1) / 2;
    this.y = (y0 + y1) / 2;
    this.scale = Math.min(this.scaleToShow(part), this.most);
    this.goal = null;
    this.fitted = part === this.bounds;
  }

  toScreen(x, y) {
    return [this.middle[0] + (x - this.x) * this.scale, this.middle[1] + (y - this.y) * this.scale];
  }

  toField(px, py) {
    return [this.x + (px - this.middle[0]) / this.scale, this.y + (py - this.middle[1]) / this.scale];
  }

  /** What is seen: left, upper, right and lower edge. */
  seen() {
    return [...this.toField(RULER.left, 0), ...this.toField(this.width, this.height - RULER.bottom)];
  }

  /** The middle stays in the field. */
  keepInside() {
    const [x0, y0, x1, y1] = this.bounds;
    this.x = Math.min(Math.max(this.x, x0), x1);
    this.y = Math.min(Math.max(this.y, y0), y1);
  }

  moveBy(dx, dy) {
    this.goal = null;
    this.fitted = false;
    this.x -= dx / this.scale;
    this.y -= dy / this.scale;
    this.keepInside();
  }

  /** Zooms about a point of the screen, at once. */
  zoomNow(factor, px, py) {
    this.fitted = false;
    const [x, y] = this.toField(px, py);
    this.scale = Math.min(Math.max(this.scale * factor, this.least), this.most);
    this.x = x - (px - this.middle[0]) / this.scale;
    this.y = y - (py - this.middle[1]) / this.scale;
    this.keepInside();
  }

  /** Zooms about a point of the screen, gently. */
  zoom(factor, [px, py] = this.middle) {
    const from = this.goal?.scale ?? this.scale;
    this.goal = { scale: Math.min(Math.max(from * factor, this.least), this.most), point: [px, py] };
  }

  /** Moves by parts of what is seen, gently. */
  glide(across, down) {
    this.fitted = false;
    const from = this.goal?.x === undefined ? this : this.goal;
    this.goal = {
      x: from.x + (across * this.width) / this.scale,
      y: from.y + (down * this.height) / this.scale,
    };
  }

  /** Goes on towards the goal; returns whether it is still under way. */
  step(milliseconds) {
    if (!this.goal) return false;
    const part = 1 - Math.exp(-milliseconds / 55);
    if (this.goal.scale) {
      const rest = Math.log(this.goal.scale / this.scale);
      const last = Math.abs(rest) < 0.002;
      this.zoomNow(Math.exp(last ? rest : rest * part), ...this.goal.point);
      if (last) this.goal = null;
    } else {
      const [dx, dy] = [this.goal.x - this.x, this.goal.y - this.y];
      const last = Math.hypot(dx, dy) * this.scale < 0.5;
      this.x += last ? dx : dx * part;
      this.y += last ? dy : dy * part;
      this.keepInside();
      if (last) this.goal = null;
    }
    return this.goal !== null;
  }
}

/** Beyond so many CSS pixels a press is a drag. */
const CLICK = 4;

/**
 * Pointers and wheel. `on` has: changed(), hover(point or null), click(point), drawsLines(event), and
 * line(from, to, finished).
 */
function listen(view, on) {
  const canvas = view.canvas;
  const pointers = new Map();
  let press = null;
  const point = (event) => [event.offsetX, event.offsetY];

  canvas.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, point(event));
    press = pointers.size === 1 ? { from: point(event), line: on.drawsLines(event), moved: false } : null;
    canvas.classList.add("moving");
    view.goal = null;
  });

  canvas.addEventListener("pointermove", (event) => {
    const to = point(event);
    const from = pointers.get(event.pointerId);
    if (!from) return on.hover(to);
    if (pointers.size === 2) {
      const [other] = [...pointers].filter(([id]) => id !== event.pointerId).map(([, p]) => p);
      const distance = (p) => Math.max(Math.hypot(p[0] - other[0], p[1] - other[1]), 1);
      view.moveBy((to[0] - from[0]) / 2, (to[1] - from[1]) / 2);
      view.zoomNow(distance(to) / distance(from), (to[0] + other[0]) / 2, (to[1] + other[1]) / 2);
    } else if (press) {
      press.moved ||= Math.hypot(to[0] - press.from[0], to[1] - press.from[1]) > CLICK;
      if (!press.moved) return;
      if (press.line) on.line(press.from, to, false);
      else view.moveBy(to[0] - from[0], to[1] - from[1]);
    }
    pointers.set(event.pointerId, to);
    on.changed();
  });

  const release = (event) => {
    if (!pointers.delete(event.pointerId)) return;
    if (press && event.type === "pointerup") {
      if (!press.moved) on.click(point(event), event.pointerType);
      else if (press.line) on.line(press.from, point(event), true);
    }
    press = null;
    if (pointers.size === 0) canvas.classList.remove("moving");
    on.changed();
  };
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);
  canvas.addEventListener("pointerleave", () => on.hover(null));

  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 33 : event.deltaMode === 2 ? 400 : 1;
    const amount = Math.min(Math.max(event.deltaY * lines, -300), 300);
    view.zoom(Math.exp(-amount * (event.ctrlKey ? 0.01 : 0.0022)), point(event));
    on.changed();
  }, { passive: false });

  return { dragging: () => pointers.size > 0 };
}
