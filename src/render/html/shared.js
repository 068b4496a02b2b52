// What the pages of images and of patterns share: elements, colours, the theme, and how a page opens.

const $ = (id) => document.getElementById(id);
const root = document.documentElement;

/** A colour as one number, in the order of an image's bytes. */
const packed = ([r, g, b], alpha = 255) => ((alpha << 24) | (b << 16) | (g << 8) | r) >>> 0;

/** The 256 colours of each map. */
const MAPS = Object.fromEntries(HEADER.colormaps.map(([name, text]) => [
  name,
  Uint32Array.from({ length: 256 }, (_, i) => {
    const hex = parseInt(text.slice(6 * i, 6 * i + 6), 16);
    return packed([hex >> 16, (hex >> 8) & 255, hex & 255]);
  }),
]));

/** Changes from light to dark, or back. */
function switchTheme() {
  const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  root.dataset.theme = dark ? "light" : "dark";
}

/** Opens the page, unless the browser cannot unpack it. */
function start(open) {
  if (typeof DecompressionStream === "undefined") {
    complain("This browser is too old to unpack the page: Chrome or Edge 103, Firefox 113, Safari 16.4 or newer can.");
  } else {
    open().catch((error) => complain(error.message));
    checkEnd();
  }
}
