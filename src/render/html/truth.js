// The atomic columns: where they are and what they hold.

class Columns {
  constructor(header) {
    this.header = header;
    this.loaded = false;
  }

  async open() {
    const { header } = this;
    const [counts, x, y, kind] = await Promise.all([
      blob16(header.counts), blob16(header.x), blob16(header.y), blob(header.kind),
    ]);
    const n = header.count;
    this.x = new Float64Array(n);
    this.y = new Float64Array(n);
    this.kind = new Uint32Array(n);
    /** Index of the first column of each cell, and the end. */
    this.first = new Uint32Array(counts.length + 1);
    let index = 0;
    for (let cell = 0; cell < counts.length; cell++) {
      const left = header.corner[0] + (cell % header.cells[0]) * header.cell;
      const top = header.corner[1] + Math.floor(cell / header.cells[0]) * header.cell;
      let steps = 0;
      for (let k = 0; k < counts[cell]; k++, index++) {
        steps += x[index];
        this.x[index] = left + steps * header.step;
        this.y[index] = top + y[index] * header.step;
        this.kind[index] = kind[index] | (kind[n + index] << 8) | (kind[2 * n + index] << 16);
      }
      this.first[cell + 1] = index;
    }
    const sums = [0, 0, 0];
    for (const k of this.kind) for (let i = 0; i < 3; i++) sums[i] += header.kinds[k][i];
    [this.sites, this.vacancies, this.substitutions] = sums;
    await this.openDefects();
    /** Columns along a unit of length, on average. */
    this.perUnit = Math.sqrt(this.density());
    /** Radius of the ring about a column: that of the pictures, less where columns are dense. */
    this.ring = Math.min(RING, 0.42 / this.perUnit);
    this.loaded = true;
  }

  async openDefects() {
    const { defects } = this.header;
    if (!defects) return;
    [this.defectName, this.defectDepth] = await Promise.all([blob(defects.name), blob16(defects.depth)]);
    this.firstDefect = new Uint32Array(this.header.count + 1);
    this.kind.forEach((kind, i) => {
      const [, vacancies, substitutions] = this.header.kinds[kind];
      this.firstDefect[i + 1] = this.firstDefect[i] + vacancies + substitutions;
    });
  }

  /** Columns to the square unit, on average. */
  density() {
    const { cell } = this.header;
    const cells = this.first.filter((start, i) => i > 0 && start > this.first[i - 1]).length;
    return this.header.count / Math.max(cells * cell * cell, 1e-9);
  }

  /** Sites, vacancies, substitutions and composition of a column. */
  contents(index) {
    const [sites, vacancies, substitutions, composition] = this.header.kinds[this.kind[index]];
    return { sites, vacancies, substitutions, composition };
  }

  /** Names and depths of the defects of a column, as far as the file tells. */
  defects(index) {
    if (!this.firstDefect) return [];
    const found = [];
    for (let k = this.firstDefect[index]; k < this.firstDefect[index + 1]; k++) {
      const name = this.header.defects.names[this.defectName[k]];
      found.push({ name, depth: this.defectDepth[k] * this.header.step });
    }
    return found;
  }

  /** Calls `visit(index, x, y)` for the columns in a rectangle. */
  within([x0, y0, x1, y1], visit) {
    const { corner, cell, cells } = this.header;
    const range = (low, high, k) => [
      Math.max(0, Math.floor((low - corner[k]) / cell)),
      Math.min(cells[k] - 1, Math.floor((high - corner[k]) / cell)),
    ];
    const [i0, i1] = range(x0, x1, 0);
    const [j0, j1] = range(y0, y1, 1);
    for (let j = j0; j <= j1; j++) for (let i = i0; i <= i1; i++) {
      const at = j * cells[0] + i;
      for (let k = this.first[at]; k < this.first[at + 1]; k++) {
        if (this.x[k] >= x0 && this.x[k] <= x1 && this.y[k] >= y0 && this.y[k] <= y1) visit(k, this.x[k], this.y[k]);
      }
    }
  }

  /** The nearest column not farther than `most`; -1 if there is none. */
  nearest(x, y, most) {
    let [best, distance] = [-1, most];
    this.within([x - most, y - most, x + most, y + most], (k, cx, cy) => {
      const d = Math.hypot(cx - x, cy - y);
      if (d <= distance) [best, distance] = [k, d];
    });
    return best;
  }
}
