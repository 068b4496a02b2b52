// Reading what the page holds: the header, and blobs (deflated, in base64), which stand in elements after
// this script and may still be on their way.

const HEADER = JSON.parse(document.getElementById("header").textContent);

const pause = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));

const CUT = "This page is cut off; make or copy it again.";

const isCut = () => document.readyState !== "loading" && !document.getElementById("end");

/** Tells the reader of the page what went wrong. */
function complain(text) {
  const message = document.getElementById("message");
  // What was told first is nearer to the cause.
  if (!message.hidden) return;
  message.textContent = isCut() ? CUT : text;
  message.hidden = false;
}

/** Whether something went wrong. */
const failed = () => !document.getElementById("message").hidden;

/** The text of a blob, once all of it is there. */
async function blobText(number) {
  for (;;) {
    const element = document.getElementById("b" + number);
    const parsed = document.readyState !== "loading";
    if (element && (element.nextElementSibling || parsed)) return element.textContent;
    if (parsed) throw new Error(CUT);
    await pause(5);
  }
}

/** Says so if the end of the page is missing. */
function checkEnd() {
  if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", checkEnd);
  else if (isCut()) complain(CUT);
}

function fromBase64(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

/** The bytes of a blob. */
async function blob(number) {
  const packed = fromBase64(await blobText(number));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** A blob of unsigned whole numbers of 16 bits: all low, then all high bytes. */
async function blob16(number) {
  const bytes = await blob(number);
  const n = bytes.length / 2;
  return Uint16Array.from({ length: n }, (_, i) => bytes[i] | (bytes[n + i] << 8));
}

/** Text of a number with so many significant digits, without an exponent for usual sizes. */
function digits(value, significant = 4) {
  if (!Number.isFinite(value)) return String(value);
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-4 || size >= 1e7)) return value.toExponential(significant - 1);
  const decimals = size === 0 ? 0 : Math.max(0, significant - 1 - Math.floor(Math.log10(size)));
  return value.toFixed(Math.min(decimals, 12));
}
