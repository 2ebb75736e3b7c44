// The live page: what the controls say is computed, and the robot, the plots and the readings follow.

function startLive(root) {
  const live = DATA.live;
  const find = (selector) => root.querySelector(selector);
  const canvas = find(".robot");
  const [preset, weights, slider] = [find(".preset"), find("#weights"), find(".time")];
  const state = { time: 0, last: null, run: null, kept: null, frame: null };
  const controls = new Controls(root, changed);
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  let spoken = 0;

  const map = new IndexMap(find(".map"), live.index, (alpha, beta) => set({ alpha, beta }));
  const view = new TimeView(0, controls.get("stop_time"));
  const plots = {
    error: new Plot(find(".error-plot"), view, { title: "Distance from the desired position", unit: "mm", height: 190, series: [] }),
    torque: new Plot(find(".torque-plot"), view, { title: "Torques of the motors", unit: "N m", height: 190, series: [] }),
    psi: new Plot(find(".psi-plot"), view, { title: "Estimated bound of the uncertainty", unit: "", height: 150, series: [] }),
  };
  const engine = new Engine(
    live.worker,
    { loop: { block: "loop-module", description: live.loop }, acting: { block: "acting-module", description: live.acting } },
    { result: show, share: (part) => (find(".state").textContent = `computing: ${Math.round(100 * part)} %`), trouble: complain },
  );

  function ask() {
    const [start, acts] = [{}, {}];
    const values = controls.values();
    for (const [name, targets] of Object.entries(live.targets)) {
      for (const target of targets) {
        if (target.startsWith("acts.")) acts[target.slice(5)] = values[name];
        else start[target] = values[name];
      }
    }
    const { step, tolerance, steadyAfter } = live;
    engine.ask({ start, acts, stopTime: values.stop_time, step, tolerance, steadyAfter });
    map.show(values.alpha, values.beta);
    const J = map.value(Math.max(values.alpha, 1e-9), values.beta);
    const [now, least] = root.querySelectorAll(".J b");
    now.textContent = values.alpha > 0 ? shown(J) : "∞";
    least.textContent = shown(map.row.J);
  }

  function changed() {
    preset.value = "";
    ask();
  }

  function set(values) {
    for (const [name, value] of Object.entries(values)) if (controls.fields.has(name)) controls.set(name, value);
    changed();
  }

  function complain(text) {
    const trouble = find(".trouble");
    trouble.hidden = !text;
    if (trouble.textContent !== text) trouble.textContent = text;
    root.dataset.state = text ? "failed" : "shown";
  }

  function show(result, { took, waited }) {
    const heard = performance.now();
    complain(result.error ?? "");
    const { step, robot } = live;
    state.run = { robot, start: 0, step, rows: result.rows, columns: result.columns, time: result.time, readings: result };
    state.label = preset.value || "own settings";
    const stop = controls.get("stop_time");
    if (view.all.to !== stop) {
      Object.assign(view.all, { from: 0, to: stop });
      view.showAll();
      slider.max = stop;
      state.time = Math.min(state.time, stop);
    }
    plot();
    read(".rms", result.rms);
    read(".peak", result.peak);
    read(".effort", result.effort);
    draw();
    find(".state").textContent = `${stop} s of the robot, computed in ${took.toFixed(0)} ms on this machine`;
    requestAnimationFrame(() => { // plots are drawn before
      root.dataset.waited = (waited + performance.now() - heard).toFixed(1);
      root.dataset.runs = Number(root.dataset.runs ?? 0) + 1;
    });
    clearTimeout(spoken);
    spoken = setTimeout(() => (find(".spoken").textContent = result.error ?? words(result)), 700); // not at each move
  }

  const read = (selector, value) => (find(selector).textContent = Number.isFinite(value) ? shown(value, 3) : "–");
  const words = ({ rms, peak, effort }) =>
    `Error ${shown(rms, 3)} millimetres root mean square, ${shown(peak, 3)} at most; torque ${shown(effort, 3)} newton metres.`;

  function plot() {
    const { run, kept } = state;
    const curve = (of, name, label, more = {}) => ({ label, times: of.time, values: of.columns[name], ...more });
    const before = kept ? [curve(kept, "error", "kept", { colour: 3, dash: [4, 3] })] : [];
    plots.error.set({ series: [curve(run, "error", "now", { colour: 0, dash: [] }), ...before] });
    plots.torque.set({ series: [1, 2, 3].map((i) => curve(run, `tau${i}`, `motor ${i}`, { colour: i - 1, dash: [] })) });
    plots.psi.set({ series: [1, 2].map((i) => curve(run, `psi${i}`, `ψ${"₁₂"[i - 1]}`, { colour: i - 1 })) });
  }

  function draw() {
    if (!state.run?.rows) return;
    drawRobot(canvas, state.run, state.time, { view: "whole", trail: true, forces: false, torques: true });
    slider.value = state.time;
    slider.setAttribute("aria-valuetext", `${state.time.toFixed(2)} seconds`);
  }

  function frame(now) {
    const passed = state.last === null ? 0 : Math.min((now - state.last) / 1e3, 0.1);
    state.last = now;
    if (state.run) {
      const end = state.run.step * (state.run.rows - 1);
      state.time = state.time + passed > end ? 0 : state.time + passed;
      if (!engine.waiting) draw(); // else the result draws, sooner if nothing else does
    }
    state.frame = requestAnimationFrame(frame);
  }

  function play(on) {
    if (on === (state.frame !== null)) return;
    if (!on) cancelAnimationFrame(state.frame);
    state.last = null;
    state.frame = on ? requestAnimationFrame(frame) : null;
    find(".play").textContent = on ? "Pause" : "Play";
  }

  find(".play").addEventListener("click", () => play(state.frame === null));
  slider.addEventListener("input", () => {
    play(false);
    state.time = Number(slider.value);
    draw();
  });
  preset.addEventListener("change", () => {
    const name = preset.value;
    if (!name) return;
    controls.reset();
    const values = live.presets[name];
    if (values.weights) chooseWeights(values.weights);
    set(values);
    preset.value = name;
  });
  function chooseWeights(row) {
    weights.value = row;
    map.choose(row);
  }
  weights.addEventListener("change", () => {
    chooseWeights(weights.value);
    ask();
  });
  find(".optimum").addEventListener("click", () => set({ alpha: map.row.alpha, beta: map.row.beta }));
  find(".reset").addEventListener("click", () => {
    controls.reset();
    changed();
  });
  find(".keep").addEventListener("click", () => keep(state.run));
  find(".drop").addEventListener("click", () => keep(null));
  function keep(run) {
    state.kept = run;
    find(".drop").hidden = !run;
    find(".of-kept").hidden = !run;
    if (run) read(".kept", run.readings.rms);
    if (state.run) plot();
  }

  keepPainted(canvas, draw);
  state.time = still ? controls.get("stop_time") : 0;
  if (still) find(".play").textContent = "Play";
  else play(true);
  ask();
}

document.querySelectorAll(".live").forEach(startLive);
