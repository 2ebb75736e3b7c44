// The runs of the page: columns of 32-bit floats, decoded when first asked for.

const DATA = JSON.parse(document.getElementById("data").textContent);
const RUNS = new Map(DATA.runs.map((run) => [run.key, run]));

/** Columns of a run by name; each has `rows` values, the first at `start`, then every `step` seconds. */
function columns(run) {
  if (!run.columns) {
    const bytes = Uint8Array.from(atob(run.data), (c) => c.charCodeAt(0));
    const floats = new Float32Array(bytes.buffer); // little-endian, as all machines with a browser are
    run.columns = Object.fromEntries(
      run.names.map((name, i) => [name, floats.subarray(i * run.rows, (i + 1) * run.rows)]),
    );
    run.data = null;
  }
  return run.columns;
}

function endTime(run) {
  return run.start + (run.rows - 1) * run.step;
}

/** Position of a time among the rows: whole part and fraction, held at both ends. */
function place(run, time) {
  const at = Math.min(Math.max((time - run.start) / run.step, 0), run.rows - 1);
  const row = Math.min(Math.floor(at), run.rows - 2);
  return [row, at - row];
}

/** Value of a column at a time, linear between rows; NaN where there is no such column. */
function valueAt(run, name, time) {
  const column = columns(run)[name];
  if (!column) return NaN;
  const [row, part] = place(run, time);
  return column[row] + part * (column[row + 1] - column[row]);
}

/** Colours and fonts of the style sheet, which change with the colour scheme. */
const theme = {
  cache: new Map(),
  get(name) {
    if (!this.cache.has(name)) {
      this.cache.set(name, getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim());
    }
    return this.cache.get(name);
  },
};

const repaints = [];
/** Call a function now and whenever the colour scheme or the size of an element changes. */
function keepPainted(element, paint) {
  repaints.push(paint);
  new ResizeObserver(paint).observe(element);
}
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  theme.cache.clear();
  for (const paint of repaints) paint();
});

/** Fit the pixels of a canvas to the screen; returns context, width and height in CSS pixels, cleared. */
function sized(canvas) {
  const ratio = Math.min(devicePixelRatio || 1, 2); // more is not seen and takes time
  const width = canvas.clientWidth;
  const height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return [context, width, height];
}

/** Numbers for people: as many digits as matter, a real minus sign. */
function shown(value, digits = 3) {
  if (!Number.isFinite(value)) return "–";
  const size = Math.abs(value);
  const text = size !== 0 && (size < 1e-3 || size >= 1e5) ? value.toExponential(digits - 1) : value.toPrecision(digits);
  return text.replaceAll("-", "−");
}

/** Round numbers that divide a range into about so many parts. */
function ticks(low, high, parts) {
  const rough = (high - low) / Math.max(parts, 1);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * ([1, 2, 5, 10].find((m) => m * power >= rough * 0.999) ?? 10);
  const first = Math.ceil(low / step - 1e-9);
  const last = Math.floor(high / step + 1e-9);
  return Array.from({ length: Math.max(last - first + 1, 0) }, (_, i) => (first + i) * step);
}

/** The largest of 1, 2, 5 times a power of ten that is not above a value. */
function roundBelow(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return power * [5, 2, 1].find((m) => m * power <= value * 1.001);
}
