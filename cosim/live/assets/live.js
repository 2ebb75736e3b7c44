// Curves of a run that goes on, from a stream of rows, and commands to it.

const EVERY = 200; // ms between two drawings

/** A column that grows. */
class Column {
  constructor() {
    this.memory = new Float64Array(1024);
    this.length = 0;
    this.whole = true;
  }

  push(value) {
    if (this.length === this.memory.length) {
      const grown = new Float64Array(2 * this.length);
      grown.set(this.memory);
      this.memory = grown;
    }
    this.whole &&= Number.isFinite(value);
    this.memory[this.length++] = value;
  }

  /** All values, null where there is none. */
  get values() {
    const values = this.memory.subarray(0, this.length);
    return this.whole ? values : Array.from(values, (v) => (Number.isFinite(v) ? v : null));
  }
}

function startLive() {
  const { names, units, start, stop } = DATA.live;
  const columns = ["time", ...names].map(() => new Column());
  const view = new TimeView(start, start + 1e-9);
  const state = document.getElementById("state");
  const now = document.getElementById("now");
  const done = document.getElementById("done");
  const box = document.querySelector(".panels");
  const panels = [];
  let changed = false;
  let [seenAt, seenTime] = [performance.now(), start];

  const made = new Map();
  const watcher = new IntersectionObserver(
    (entries) => {
      for (const { isIntersecting, target } of entries) {
        if (!isIntersecting) continue;
        made.get(target).seen = changed = true;
        watcher.unobserve(target);
      }
    },
    { rootMargin: "200px" },
  );
  const groups = new Map();
  names.forEach((name, i) => {
    const vector = name.replace(/\[[\d,]+\]$/, "");
    if (!groups.has(vector)) groups.set(vector, []);
    groups.get(vector).push({ name, column: columns[i + 1], label: name.slice(vector.length) || vector });
  });
  for (const [title, curves] of groups) {
    const unit = units[curves[0].name] ?? "";
    const heading = make("h3", {}, title, unit ? make("small", {}, ` (${unit})`) : "");
    const area = make("div", {});
    const panel = make("div", { class: "panel" }, heading, area);
    box.append(panel);
    area.style.minHeight = "262px"; // so that panels further down are not in view yet
    const one = { title, unit, curves, panel, area, plot: null, seen: false };
    panels.push(one);
    made.set(area, one);
    watcher.observe(area);
  }
  document.querySelector(".search").addEventListener("input", (event) => {
    const wanted = event.target.value.trim().toLowerCase();
    for (const { title, panel } of panels) panel.hidden = !title.toLowerCase().includes(wanted);
  });
  document.querySelector('[data-act="all"]').addEventListener("click", () => view.showAll());

  const seriesOf = (curves) => {
    const times = columns[0].values;
    return curves.map(({ label, column }) => ({ label, times, values: column.values }));
  };

  function draw() {
    if (!changed || columns[0].length < 2) return;
    changed = false;
    const times = columns[0].values;
    const last = times[times.length - 1];
    const whole = view.isWhole;
    view.all = { from: times[0], to: last };
    if (whole) [view.from, view.to] = [view.all.from, last];
    for (const one of panels) {
      if (one.panel.hidden || !one.seen) continue;
      if (one.plot) one.plot.grown(seriesOf(one.curves));
      else one.plot = new Plot(one.area, view, { title: one.title, unit: one.unit, series: seriesOf(one.curves) });
    }
    view.changed();
    const at = performance.now();
    const rate = ((last - seenTime) / (at - seenAt)) * 1000;
    [seenAt, seenTime] = [at, last];
    now.textContent = `t = ${view.text(last)} s of ${view.text(stop)} s, ${shown(rate, 2)} s a second`;
  }
  setInterval(draw, EVERY);

  function say(text, kind) {
    state.textContent = text;
    state.className = `badge ${kind}`;
  }

  const stream = new EventSource("rows");
  stream.onopen = () => say("running", "open");
  stream.onerror = () => say("the program has ended", "part");
  stream.onmessage = (event) => {
    const message = JSON.parse(event.data);
    if (message.rows) {
      const bytes = Uint8Array.from(atob(message.rows), (c) => c.charCodeAt(0));
      const values = new Float64Array(bytes.buffer);
      for (let k = 0; k < values.length; k++) columns[k % columns.length].push(values[k]);
      changed = true;
    } else if (message.done) {
      done.textContent = message.done;
    } else if (message.state) {
      const ended = !["running", "paused"].includes(message.state);
      say(message.state, message.state === "completed" ? "good" : ended ? "part" : "open");
      button("pause").disabled = ended || message.state === "paused";
      button("resume").disabled = message.state !== "paused";
      button("stop").disabled = ended;
      if (ended) {
        stream.close();
        for (const input of document.querySelectorAll(".settings input")) input.disabled = true;
      }
    }
  };

  const button = (act) => document.querySelector(`[data-act="${act}"]`);
  const command = (body) => fetch("command", { method: "POST", body: JSON.stringify(body) });
  for (const act of ["pause", "resume", "stop"]) button(act).addEventListener("click", () => command({ [act]: true }));
  for (const input of document.querySelectorAll(".settings input"))
    input.addEventListener("change", () => {
      if (input.value !== "" && input.checkValidity()) command({ set: { [input.dataset.name]: input.valueAsNumber } });
    });
}

startLive();
