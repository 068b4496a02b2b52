// Images as pyramids of tiles: loading, colouring, drawing, and reading values back.

/** Tiles that are inflated at a time. */
const LOADING = 4;
/** Decoded tiles that are kept, at least. */
const KEPT = 96;
/** Milliseconds of a frame that colouring may take; the rest waits for the next. */
const PAINTING = 8;

const painting = { until: 0, late: false };

/** Begins a frame's share of colouring. */
function allowPainting() {
  painting.until = performance.now() + PAINTING;
  painting.late = false;
}

const queue = { running: 0, waiting: [], arrived: () => {} };

/** Starts loading what is waiting, the newest wish first. */
function load() {
  while (queue.running < LOADING && queue.waiting.length > 0) {
    const tile = queue.waiting.pop();
    queue.running++;
    tile.load().then(() => { tile.state = "ready"; }, (error) => {
      tile.state = "failed";
      complain(error.message);
    }).finally(() => {
      queue.running--;
      tile.resolve();
      queue.arrived();
      load();
    });
  }
}

/** Forgets wishes that nobody has any more. */
function forgetWaiting(keep) {
  queue.waiting = queue.waiting.filter((tile) => {
    if (keep(tile)) return true;
    tile.owner.forget(tile);
    tile.resolve();
    return false;
  });
}

class Tile {
  constructor(owner, level, column, row) {
    Object.assign(this, { owner, level, column, row, state: "waiting", used: 0, painted: -1 });
    this.done = new Promise((resolve) => { this.resolve = resolve; });
    const [width, height] = owner.levels[level].size;
    this.width = Math.min(HEADER.tile, width - column * HEADER.tile);
    this.height = Math.min(HEADER.tile, height - row * HEADER.tile);
  }

  async load() {
    const level = this.owner.levels[this.level];
    const across = Math.ceil(level.size[0] / HEADER.tile);
    const bytes = await blob(level.tiles + this.row * across + this.column);
    this.codes = decode(bytes, this.width, this.height, level.bits);
  }
}

/** The codes of a tile; see pyramid.rs. */
function decode(bytes, width, height, bits) {
  const n = width * height;
  const codes = bits === 8 ? bytes.slice(1, 1 + n) : new Uint16Array(n);
  if (bits === 16) {
    for (let i = 0; i < n; i++) codes[i] = bytes[1 + i] | (bytes[1 + n + i] << 8);
  }
  if (bytes[0] === 1) {
    for (let i = 1; i < width; i++) codes[i] += codes[i - 1];
    for (let start = width; start < n; start += width) {
      codes[start] += codes[start - width];
      for (let i = start + 1; i < start + width; i++) codes[i] += codes[i - 1] + codes[i - width] - codes[i - width - 1];
    }
  }
  return codes;
}

/** One image, or the map of phases. */
class Pyramid {
  constructor(levels) {
    this.levels = levels;
    this.tiles = new Map();
    this.colors = [];
    this.version = 0;
    /** Pixels that are made of one of the finest level, along each axis. */
    this.factor = 1;
    this.colorOf = null;
  }

  /** Loads the tables, the coarse ones first. */
  async open(from = 0) {
    for (let k = this.levels.length - 1; k >= from; k--) {
      const level = this.levels[k];
      if (level.values) continue;
      const [table, histogram] = await Promise.all([blob(level.table), blob(level.histogram)]);
      level.counts = new Uint32Array(histogram.buffer);
      level.values = new Float32Array(table.buffer);
    }
  }

  /** The values at two percentages of a level's pixels, by nearest rank. */
  percentiles(level, percents) {
    const { values, counts } = this.levels[level];
    const total = counts.reduce((sum, n) => sum + n, 0);
    return percents.map((percent) => {
      const rank = Math.round((percent / 100) * (total - 1));
      let passed = 0;
      for (let code = 0; code < counts.length; code++) {
        passed += counts[code];
        if (passed > rank) return values[code];
      }
      return values[values.length - 1];
    });
  }

  /** Sets the colours (uint32 of red, green, blue, alpha) of a level's codes. */
  setColors(level, colors) {
    this.colors[level] = colors;
    this.version++;
  }

  /** Enlarges the finest level by interpolation; `colorOf` gives the colour of a value there. */
  setEnlargement(factor, colorOf) {
    this.factor = factor;
    this.colorOf = colorOf;
    this.version++;
  }

  find(level, column, row) {
    return this.tiles.get(level + "/" + column + "/" + row);
  }

  forget(tile) {
    this.tiles.delete(tile.level + "/" + tile.column + "/" + tile.row);
  }

  /** A tile, wished for if it is not there. */
  wish(level, column, row) {
    let tile = this.find(level, column, row);
    if (!tile) {
      tile = new Tile(this, level, column, row);
      this.tiles.set(level + "/" + column + "/" + row, tile);
      queue.waiting.push(tile);
    }
    return tile;
  }

  /** The value of a pixel of the finest level; undefined (and wished for) if it is not there. */
  value(x, y) {
    const [width, height] = this.levels[0].size;
    if (x < 0 || y < 0 || x >= width || y >= height || !this.levels[0].values) return undefined;
    const tile = this.wish(0, Math.floor(x / HEADER.tile), Math.floor(y / HEADER.tile));
    tile.wanted = true;
    if (tile.state !== "ready") return undefined;
    return this.levels[0].values[tile.codes[(y % HEADER.tile) * tile.width + (x % HEADER.tile)]];
  }

  /** Waits for all tiles that hold pixels near the points. */
  async ready(points) {
    await this.open();
    const [width, height] = this.levels[0].size;
    const tiles = new Set();
    for (const [x, y] of points) {
      for (const [dx, dy] of [[0, 0], [1, 0], [0, 1], [1, 1]]) {
        const at = (v, size) => Math.floor(Math.min(Math.max(v, 0), size - 1) / HEADER.tile);
        tiles.add(this.wish(0, at(Math.floor(x) + dx, width), at(Math.floor(y) + dy, height)));
      }
    }
    tiles.forEach((tile) => { tile.wanted = true; });
    load();
    await Promise.all([...tiles].map((tile) => tile.done));
  }

  /** Value between pixels, by linear interpolation; beyond the edge, that of the edge. */
  interpolated(x, y) {
    const [width, height] = this.levels[0].size;
    const within = (v, size) => Math.min(Math.max(v, 0), size - 1);
    const [cx, cy] = [within(x, width), within(y, height)];
    const [i, j] = [Math.floor(cx), Math.floor(cy)];
    const at = (dx, dy) => this.value(Math.min(i + dx, width - 1), Math.min(j + dy, height - 1));
    const [s, t] = [cx - i, cy - j];
    return (at(0, 0) * (1 - s) + at(1, 0) * s) * (1 - t) + (at(0, 1) * (1 - s) + at(1, 1) * s) * t;
  }

  /** A canvas with the tile in colour: in its last ones, or null, when there is no time for new ones. */
  painted(tile) {
    if (tile.painted !== this.version) {
      if (performance.now() > painting.until) {
        painting.late = true;
        return tile.painted < 0 ? null : tile.canvas;
      }
      const factor = tile.level === 0 ? this.factor : 1;
      const [width, height] = [tile.width * factor, tile.height * factor];
      if (tile.canvas?.width !== width) tile.canvas = Object.assign(document.createElement("canvas"), { width, height });
      const context = tile.canvas.getContext("2d");
      const image = context.createImageData(width, height);
      const pixels = new Uint32Array(image.data.buffer);
      if (factor > 1) {
        const table = this.levels[0].values;
        const values = enlarge(Float32Array.from(tile.codes, (code) => table[code]), tile.width, tile.height, factor);
        for (let i = 0; i < values.length; i++) pixels[i] = this.colorOf(values[i]);
      } else {
        const colors = this.colors[tile.level];
        const codes = tile.codes;
        for (let i = 0; i < codes.length; i++) pixels[i] = colors[codes[i]];
      }
      context.putImageData(image, 0, 0);
      tile.painted = this.version;
    }
    return tile.canvas;
  }

  /** The level whose pixels are half to one pixel of the screen, which has `size` to a pixel of the image. */
  levelFor(size) {
    return Math.min(Math.max(Math.floor(-Math.log2(size) + 1e-9), 0), this.levels.length - 1);
  }

  /**
   * Draws the part that is seen; `place(x, y)` gives device pixels of edges of image pixels. Coarser
   * tiles stand in for those that are still missing. Returns whether all were there.
   */
  draw(context, level, part, place, frame) {
    if (!this.colors[level]) level = this.levels.length - 1;
    if (!this.colors[level]) return false;
    let complete = true;
    const each = (grow, visit) => {
      const span = HEADER.tile << level;
      const [width, height] = this.levels[0].size;
      const range = (low, high, size) => [
        Math.max(0, Math.floor(low / span) - grow),
        Math.min(Math.ceil(size / span) - 1, Math.floor(high / span) + grow),
      ];
      const [x0, x1] = range(part[0], part[2], width);
      const [y0, y1] = range(part[1], part[3], height);
      for (let row = y0; row <= y1; row++) for (let column = x0; column <= x1; column++) visit(column, row);
    };
    // Neighbours are wished for first, since the newest wish is loaded first.
    each(1, (column, row) => { this.wish(level, column, row).used = frame; });
    each(0, (column, row) => {
      const tile = this.find(level, column, row);
      if (tile.state === "waiting") {
        // Once more to the end of the queue, before the neighbours.
        const at = queue.waiting.indexOf(tile);
        if (at >= 0) queue.waiting.push(...queue.waiting.splice(at, 1));
      }
      if (tile.state === "ready" && this.drawTile(context, tile, place, null)) return;
      complete = complete && tile.state === "failed";
      this.drawStandIn(context, tile, place, frame);
    });
    return complete && !painting.late;
  }

  /** Draws a tile or a part of it; returns whether it could. */
  drawTile(context, tile, place, source) {
    const canvas = this.painted(tile);
    if (!canvas) return false;
    const [left, top, width, height] = source ?? [0, 0, tile.width, tile.height];
    const [x, y] = [tile.column * HEADER.tile + left, tile.row * HEADER.tile + top];
    const [x0, y0] = place(x << tile.level, y << tile.level);
    const [x1, y1] = place((x + width) << tile.level, (y + height) << tile.level);
    // Whole device pixels leave no seams.
    const [a, b] = [Math.round(x0), Math.round(y0)];
    const f = canvas.width / tile.width;
    context.drawImage(canvas, left * f, top * f, width * f, height * f, a, b, Math.round(x1) - a, Math.round(y1) - b);
    return true;
  }

  /** Draws the place of a missing tile from the next coarser level that is there. */
  drawStandIn(context, tile, place, frame) {
    for (let level = tile.level + 1; level < this.levels.length; level++) {
      const shift = level - tile.level;
      const coarse = this.find(level, tile.column >> shift, tile.row >> shift);
      if (!coarse || coarse.state !== "ready" || !this.colors[level]) continue;
      coarse.used = frame;
      const step = HEADER.tile >> shift;
      if (step < 1) return;
      const left = (tile.column % (1 << shift)) * step;
      const top = (tile.row % (1 << shift)) * step;
      const width = Math.min(step, coarse.width - left);
      const height = Math.min(step, coarse.height - top);
      if (width <= 0 || height <= 0 || this.drawTile(context, coarse, place, [left, top, width, height])) return;
    }
  }

  /** Drops tiles that were not used for long. */
  trim(frame) {
    const ready = [...this.tiles.values()].filter((t) => t.state === "ready" && t.level < this.levels.length - 1);
    const seen = ready.filter((t) => t.used === frame).length;
    const excess = ready.length - Math.max(KEPT, 2 * seen);
    if (excess <= 0) return;
    ready.sort((a, b) => a.used - b.used);
    ready.slice(0, excess).forEach((tile) => this.forget(tile));
  }
}
