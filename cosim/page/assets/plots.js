// The plot: curves over time with zoom, cursor and legend, drawn by uPlot, all by keyboard and by touch, too.
//
//   const view = new TimeView(0, 15);                     // the range that plots share
//   new Plot(element, view, {
//     title: "plant.tau_a", unit: "N.m",                   // said to those who do not see it
//     series: [{ label: "[1]", times, values }, ...],      // times (s), values with null where there is none;
//   });                                                    // also colour, dash, hidden, stepped, dots, alpha
//
// Further settings: `bands` [{ lower, upper }] of series by number, `log`, `events` [{ time, text }], `height`, `range`
// [low, high] of the values, `say` (whether the legend is shown), `named` (whether the axis of values has the unit beside
// it), and `resolution` (seconds a value stands for).
// `plot.set({ series, ... })` changes them. Values may be many: lines are thin and solid where they are dense.

const COLOURS = 8; // --line-0 ... of the style sheet
const DASHES = [[], [7, 3], [2, 2], [9, 3, 2, 3], [4, 4], [12, 3], [1, 3], [7, 2, 1, 2, 1, 2]];
const SPARSE = 2; // points a pixel from which on lines are solid and thin: dashes and width cost most of the time

/** The time range (s) that plots show, and the time of the cursor. */
class TimeView {
  constructor(from, to) {
    this.all = { from, to: to > from ? to : from + 1 };
    this.from = this.all.from;
    this.to = this.all.to;
    this.cursor = null;
    this.plots = new Set();
    this.followers = [];
  }

  /** Call a function after each change. */
  follow(react) {
    this.followers.push(react);
  }

  zoom(from, to) {
    const whole = this.all.to - this.all.from;
    const width = Math.min(Math.max(to - from, whole * 1e-7), whole);
    const middle = (from + to) / 2;
    this.from = Math.min(Math.max(middle - width / 2, this.all.from), this.all.to - width);
    this.to = this.from + width;
    if (this.cursor !== null && (this.cursor < this.from || this.cursor > this.to)) this.cursor = null;
    for (const plot of this.plots) plot.zoomed();
    this.changed();
  }

  showAll() {
    this.zoom(this.all.from, this.all.to);
  }

  /** Zoom by a factor around the cursor, or the middle. */
  magnify(factor) {
    const at = this.cursor ?? (this.from + this.to) / 2;
    this.zoom(at - (at - this.from) / factor, at + (this.to - at) / factor);
  }

  shift(part) {
    const by = part * (this.to - this.from);
    this.zoom(this.from + by, this.to + by);
  }

  point(time, from = null) {
    this.cursor = time === null ? null : Math.min(Math.max(time, this.from), this.to);
    for (const plot of this.plots) if (plot !== from) plot.pointed();
    this.changed();
  }

  /** A time with as many digits as tell it from others in view. */
  text(time) {
    const part = Math.max(Math.abs(this.from), Math.abs(this.to)) / (this.to - this.from);
    return shown(time, Math.min(4 + Math.max(0, Math.ceil(Math.log10(part))), 15));
  }

  changed() {
    for (const react of this.followers) react(this);
  }

  get isWhole() {
    return this.from === this.all.from && this.to === this.all.to;
  }
}

/** Position of the last row that is not later than a time. */
function rowAt(times, time) {
  let [low, high] = [0, times.length - 1];
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= time) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** Value of a curve at a time, linear between rows unless stepped; null outside and in gaps. */
function valueAt({ times, values, stepped }, time) {
  const n = times.length;
  if (!n || time < times[0] - 1e-9 || time > times[n - 1] + 1e-9) return null;
  const row = rowAt(times, time);
  const [before, after] = [values[row], values[Math.min(row + 1, n - 1)]];
  if (stepped || before === null || after === null || row === n - 1 || times[row + 1] === times[row]) return before;
  const part = (time - times[row]) / (times[row + 1] - times[row]);
  return (1 - part) * before + part * after;
}

class Plot {
  constructor(root, view, settings) {
    this.root = root;
    this.view = view;
    this.area = make("div", { class: "plot-area", tabindex: "0", role: "application" });
    this.legend = make("ul", { class: "plot-legend" });
    this.spoken = make("p", { class: "unseen", role: "status", "aria-live": "polite" });
    root.classList.add("plot");
    root.append(this.area, this.legend, this.spoken);
    this.visible = false;
    this.stale = false;
    this.set(settings);
    view.plots.add(this);
    new ResizeObserver(() => this.resized()).observe(this.area);
    new IntersectionObserver((entries) => {
      this.visible = entries.at(-1).isIntersecting;
      if (this.visible && this.stale) this.zoomed();
    }, { rootMargin: "100px" }).observe(this.area);
    theme.follow(() => {
      this.uplot?.redraw(false);
    });
    this.area.addEventListener("keydown", (event) => this.pressed(event));
    this.area.addEventListener("blur", () => view.point(null));
  }

  /** Show other curves, or the same ones in another way. */
  set(settings) {
    const before = this.settings;
    this.settings = { height: 230, events: [], bands: [], log: false, say: true, ...before, ...settings };
    const { title, unit, series } = this.settings;
    if (this.uplot && styles(before) === styles(this.settings)) { // other values only: no new plot, which takes long
      series.forEach((s, i) => (s.hidden = before.series[i].hidden));
      this.renewed();
      return;
    }
    this.area.setAttribute(
      "aria-label",
      `${title}${unit ? ` in ${unit}` : ""} over time. Arrow keys move the cursor, plus and minus zoom, Escape shows all.`,
    );
    this.area.style.minHeight = `${this.settings.height}px`; // before it is drawn, so that what follows stays in place
    this.outputs = [];
    this.legend.replaceChildren(...(this.settings.say ? series.map((s, i) => this.entry(s, i)) : []));
    this.build();
  }

  /** The same curves with further rows: drawn again where they are in view. */
  grown(series) {
    series.forEach((s, i) => Object.assign(this.settings.series[i], s));
    if (this.uplot && this.visible) this.renewed();
  }

  /** Draw what the curves are now, or when they come into view. */
  renewed() {
    this.uplot.setData(this.table(), false);
    this.stale = !this.visible;
    if (this.visible) this.uplot.setScale("x", { min: this.view.from, max: this.view.to });
    if (this.view.cursor !== null) this.fill();
  }

  look(i) {
    const series = this.settings.series[i];
    const number = series.colour ?? i;
    return { colour: `line-${number % COLOURS}`, dash: series.dash ?? DASHES[number % DASHES.length] };
  }

  /** A curve in the legend, which has a switch where there are several. */
  entry(series, i) {
    const { colour, dash } = this.look(i);
    const sample = make("svg", { class: "sample", viewBox: "0 0 28 8", "aria-hidden": "true" });
    sample.append(make("path", { d: "M1 4H27", class: colour, "stroke-dasharray": dash.join(" ") }));
    const output = make("output", {});
    this.outputs.push(output);
    if (this.settings.series.length === 1) return make("li", {}, output);
    const box = make("input", { type: "checkbox", checked: !series.hidden });
    box.addEventListener("change", () => {
      series.hidden = !box.checked;
      this.uplot?.setSeries(i + 1, { show: box.checked });
    });
    return make("li", {}, make("label", { class: "check" }, box, sample, make("span", {}, series.label), " ", output));
  }

  build() {
    this.uplot?.destroy();
    this.uplot = null;
    const width = this.area.clientWidth;
    if (!width) return;
    const { series, log, bands, height, range, unit, named } = this.settings;
    const data = this.table();
    const ink = () => theme.get("muted");
    const grid = { stroke: () => theme.get("grid"), width: 1 };
    const axis = { stroke: ink, grid, ticks: { ...grid, size: 4 }, font: `12px ${theme.get("font")}`, gap: 4 };
    const self = this;
    const options = {
      width,
      height,
      padding: [10, 24, 0, 0],
      legend: { show: false },
      scales: {
        x: { time: false, range: () => [self.view.from, self.view.to] },
        y: { range: (u, low, high) => range ?? margins(low, high, log) },
      },
      axes: [
        { ...axis, label: "time (s)", labelSize: 18, labelGap: 0, labelFont: axis.font, size: 26, values: (u, v) => distinct(v) },
        {
          ...axis,
          ...(named && unit ? { label: unit, labelSize: 18, labelGap: 0, labelFont: axis.font } : {}),
          values: (u, ticks) => (log ? ticks.map(power) : distinct(self.factor === 1 ? ticks : ticks.map((v) => Number((v * self.factor).toPrecision(12))))),
          size: (u, values) => 14 + 7 * Math.max(3, ...(values ?? []).map((v) => v.length)),
          space: height < 180 ? 22 : 34,
        },
      ],
      cursor: {
        drag: { x: true, y: false, setScale: false },
        points: { show: false },
        y: false,
        bind: { dblclick: () => () => (self.view.showAll(), null) },
      },
      series: [{}, ...series.map((s, i) => this.line(s, i))],
      bands: bands.map(({ lower, upper }) => ({ series: [upper + 1, lower + 1], fill: () => theme.get("band") })),
      hooks: {
        setSelect: [(u) => self.selected(u.select)],
        setCursor: [(u) => self.moved(u)],
        draw: [(u) => self.drawEvents(u)],
        setScale: [(u, key) => key === "x" && self.thin(u)],
      },
    };
    this.label = (v) => `${shown(v)}${unit && v !== null ? ` ${unit}` : ""}`;
    this.uplot = new uPlot(options, data, this.area);
    this.thin(this.uplot);
    this.touch(this.uplot.over);
    this.stale = false;
    this.root.dataset.curves = series.filter((s) => !s.hidden).length;
    if (this.view.cursor !== null) this.pointed();
  }

  /** The columns that uPlot wants: one for all times; a curve is undefined, and has no gap, where it has no row. */
  table() {
    const { series, log, range } = this.settings;
    this.factor = log || range ? 1 : factorOf(series);
    const scaled = (v) => (v === null ? null : v / this.factor);
    const drawn = (s) => {
      if (log) return Array.from(s.values, (v) => (v ? Math.log10(Math.abs(v)) : null));
      return this.factor === 1 ? s.values : Array.from(s.values, scaled);
    };
    if (series.every((s) => s.times === series[0].times)) return [series[0]?.times ?? [], ...series.map(drawn)];
    return uPlot.join(series.map((s) => [s.times, drawn(s)]));
  }

  line(series, i) {
    const { colour } = this.look(i);
    return {
      label: series.label,
      show: !series.hidden,
      stroke: () => theme.get(colour),
      alpha: series.alpha ?? 1,
      width: 1.5,
      points: { show: series.dots ? true : (u, k, first, last) => last - first < 12, filter: alone, size: 5 },
      paths: series.dots ? () => null : series.stepped ? uPlot.paths.stepped({ align: 1 }) : undefined,
    };
  }

  /** Lines as the density of the points wants them. */
  thin(u) {
    const { from, to } = this.view;
    this.settings.series.forEach((s, i) => {
      const points = rowAt(s.times, to) - rowAt(s.times, from);
      const dense = points > SPARSE * Math.max(u.over.clientWidth, 1);
      u.series[i + 1].dash = dense ? undefined : this.look(i).dash;
      u.series[i + 1].width = dense ? 1 / devicePixelRatio : 1.5;
    });
  }

  drawEvents(u) {
    const inside = this.settings.events.filter((e) => e.time >= this.view.from && e.time <= this.view.to);
    const { left, top, width, height } = u.bbox;
    const ratio = devicePixelRatio;
    const c = u.ctx;
    c.save();
    c.strokeStyle = c.fillStyle = theme.get("event");
    c.lineWidth = ratio;
    c.font = `${11 * ratio}px ${theme.get("font")}`;
    c.textBaseline = "top";
    c.textAlign = "left";
    let free = -Infinity;
    for (const { time, text } of inside.slice(0, 500)) {
      const x = Math.round(u.valToPos(time, "x", true)) + 0.5;
      c.setLineDash([3 * ratio, 3 * ratio]);
      c.beginPath();
      c.moveTo(x, top);
      c.lineTo(x, top + height);
      c.stroke();
      const wide = c.measureText(text).width;
      if (x > free && x + wide + 8 * ratio < left + width) {
        c.fillText(text, x + 4 * ratio, top + 2 * ratio);
        free = x + wide + 10 * ratio;
      }
    }
    c.restore();
  }

  zoomed() {
    if (!this.uplot) return;
    this.stale = !this.visible;
    if (!this.visible) return;
    this.uplot.setScale("x", { min: this.view.from, max: this.view.to });
  }

  resized() {
    const width = this.area.clientWidth;
    if (!width) return;
    if (!this.uplot) this.build();
    else if (width !== this.uplot.width) this.uplot.setSize({ width, height: this.settings.height });
  }

  selected({ left, width }) {
    if (width < 6) return;
    const u = this.uplot;
    const [from, to] = [u.posToVal(left, "x"), u.posToVal(left + width, "x")];
    u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    this.view.zoom(from, to);
  }

  /** The pointer has moved over this plot: others follow. */
  moved(u) {
    if (this.following || !u.cursor.event) return;
    const { left } = u.cursor;
    this.view.point(left === null || left < 0 ? null : u.posToVal(left, "x"), this);
    this.fill();
  }

  /** The cursor is where another plot, or a key, has put it. */
  pointed() {
    if (!this.uplot || !this.visible) return;
    const { cursor } = this.view;
    this.following = true;
    const left = cursor === null ? -10 : this.uplot.valToPos(cursor, "x");
    this.uplot.setCursor({ left, top: cursor === null ? -10 : 5 }, false);
    this.following = false;
    this.fill();
  }

  /** Values at the cursor, in the legend. */
  fill() {
    const { cursor } = this.view;
    this.outputs.forEach((output, i) => {
      output.textContent = cursor === null ? "" : this.label(valueAt(this.settings.series[i], cursor));
    });
  }

  say() {
    const { title, series } = this.settings;
    const values = series.filter((s) => !s.hidden).map((s) => `${s.label} ${this.label(valueAt(s, this.view.cursor))}`);
    this.spoken.textContent = `${title} at ${this.view.text(this.view.cursor)} s: ${values.join(", ")}`;
  }

  pressed(event) {
    if (event.ctrlKey || event.altKey || event.metaKey || event.target !== this.area) return;
    const { view } = this;
    const width = view.to - view.from;
    const cursor = view.cursor ?? (view.from + view.to) / 2;
    const step = width / (event.shiftKey ? 20 : 200);
    const moves = { ArrowLeft: cursor - step, ArrowRight: cursor + step, Home: view.from, End: view.to };
    if (event.key in moves) {
      view.point(moves[event.key]);
      this.say();
    } else if (event.key === "+" || event.key === "=") view.magnify(2);
    else if (event.key === "-") view.magnify(0.5);
    else if (event.key === "Escape" || event.key === "0") view.showAll();
    else return;
    event.preventDefault();
  }

  /** A finger that moves sideways selects a time range; up and down it scrolls the page; a tap sets the cursor. */
  touch(over) {
    let from = null;
    const x = (event) => event.clientX - over.getBoundingClientRect().left;
    const select = (to) =>
      this.uplot.setSelect({ left: Math.min(from, to), width: Math.abs(to - from), top: 0, height: over.clientHeight }, false);
    over.addEventListener("pointerdown", (event) => {
      if (event.pointerType !== "touch") return;
      from = x(event);
      this.view.point(this.uplot.posToVal(from, "x"));
    });
    over.addEventListener("pointermove", (event) => {
      if (event.pointerType !== "touch" || from === null) return;
      select(Math.min(Math.max(x(event), 0), over.clientWidth));
    });
    over.addEventListener("pointerup", (event) => {
      if (event.pointerType !== "touch" || from === null) return;
      from = null;
      this.selected(this.uplot.select);
    });
    over.addEventListener("pointercancel", () => {
      from = null;
      this.uplot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    });
  }
}

/** All of the settings of a plot but the values of its curves, as a text. */
function styles({ series, ...others }) {
  return JSON.stringify([others, series.map(({ times, values, hidden, ...style }) => style)]);
}

/** The power of ten that values are divided by to be drawn: uPlot has no ticks for very large and very small ones. */
function factorOf(series) {
  let largest = 0;
  for (const { values } of series) {
    for (const value of values) if (Math.abs(value) > largest && Number.isFinite(value)) largest = Math.abs(value);
  }
  return largest === 0 || (largest >= 1e-12 && largest < 1e15) ? 1 : 10 ** Math.max(Math.floor(Math.log10(largest)), -323);
}

/** Rows of points that no line goes to, for there are gaps on both sides; null where all or none are shown. */
function alone(u, k, show) {
  const values = u.data[k];
  if (show || !Array.isArray(values)) return null; // numbers all along
  const [first, last] = u.series[k].idxs;
  const rows = [];
  let [before, row] = [null, null]; // the last value, and where it is if it has none before it
  for (let i = first; i <= last; i++) {
    if (values[i] === undefined) continue; // a row of another curve
    if (values[i] === null && row !== null) rows.push(row);
    row = values[i] !== null && before === null ? i : null;
    before = values[i];
  }
  if (row !== null) rows.push(row);
  return rows.length ? rows : null;
}

function margins(low, high, log) {
  if (low === null || high === null) return [-1, 1];
  const bottom = log ? Math.max(low, high - 4) : low; // where a curve passes zero it would stretch the axis without end
  if (bottom === high) return [bottom - (Math.abs(bottom) * 0.05 || 1), high + (Math.abs(high) * 0.05 || 1)];
  const margin = 0.05 * (high - bottom);
  return [bottom - margin, high + margin];
}

function tick(value) {
  const size = Math.abs(value);
  const text = size !== 0 && (size < 1e-4 || size >= 1e6) ? value.toExponential() : String(Number(value.toPrecision(9)));
  return text.replace(/(\.\d{6})\d+e/, "$1e").replace("e+", "e").replaceAll("-", "−");
}

/** Labels of ticks; where they differ in far digits only, the distance from the first one. */
function distinct(ticks) {
  const labels = ticks.map((v) => (v === null ? "" : tick(v)));
  if (Math.max(...labels.map((l) => l.length)) < 10) return labels;
  const base = Number(ticks[0].toPrecision(6));
  const further = ticks.map((v) => Number((v - base).toPrecision(3)));
  const signed = further.map((v) => (v < 0 ? tick(v) : `+${tick(v)}`));
  return signed.map((text, i) => (i ? text : further[0] === 0 ? tick(base) : tick(base) + text));
}

/** Label of a power of ten. */
function power(value) {
  if (value === null) return "";
  return Math.abs(value - Math.round(value)) > 1e-9 ? shown(10 ** value, 2) : tick(Number((10 ** value).toPrecision(3)));
}
