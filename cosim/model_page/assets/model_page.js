// A model's own page: what its controls say is simulated, and the outputs are plotted.

const MOST = 8;

function startModelPage(root) {
  const { description, worker, panels } = DATA.model;
  const find = (selector) => root.querySelector(selector);
  const trouble = find(".trouble");
  const state = find(".state");
  const spoken = find(".spoken");
  const times = new Set(["startTime", "stopTime", "stepSize"]);
  const controls = new Controls(root, ask);
  const variables = new Map(description.variables.map((variable) => [variable.name, variable]));
  let view = null;
  let plots = [];
  let timer = 0;

  function settings() {
    const start = {};
    const experiment = {};
    for (const [name, value] of Object.entries(controls.values())) (times.has(name) ? experiment : start)[name] = value;
    return { start, ...experiment, record: panels.flatMap((panel) => panel.names) };
  }

  const engine = new Engine(worker, { model: { block: "module", description } }, {
    result: show,
    share: (part) => (state.textContent = `computing: ${Math.round(100 * part)} %`),
    trouble: complain,
  });

  function ask() {
    engine.ask({ settings: settings() });
  }

  function complain(text) {
    trouble.hidden = !text;
    if (trouble.textContent !== text) trouble.textContent = text;
    root.dataset.state = text ? "failed" : "shown";
  }

  function series({ time, values }, panel) {
    const many = panel.names.length > MOST; // of many elements some are shown at first, evenly spaced
    const first = new Set(Array.from({ length: MOST }, (_, k) => Math.round((k * (panel.names.length - 1)) / (MOST - 1))));
    return panel.names.map((name, i) => ({
      label: panel.labels[i],
      times: time,
      values: values[name] ?? new Float64Array(0),
      stepped: variables.get(name).variability === "discrete",
      hidden: plots[panel.number]?.settings.series[i]?.hidden ?? (many && !first.has(i)),
    }));
  }

  function show(run, { took, waited }) {
    complain([run.error, ...run.warnings].filter(Boolean).join(" ")); // what came before it is shown all the same
    root.dataset.state = run.error ? "failed" : "shown";
    const { time } = run;
    const [from, to] = [Number(controls.get("startTime")), Number(controls.get("stopTime"))];
    if (!view || view.all.from !== from || view.all.to !== to) {
      for (const element of root.querySelectorAll(".panel .drawn")) element.replaceChildren();
      view = new TimeView(from, to);
      plots = [];
      panels.forEach((panel, number) => {
        panel.number = number;
        const element = root.querySelector(`[data-panel="${number}"] .drawn`);
        plots[number] = new Plot(element, view, { title: panel.title, unit: panel.unit, series: series(run, panel) });
      });
    } else panels.forEach((panel) => plots[panel.number].set({ series: series(run, panel) }));
    const points = `${time.length} communication points`;
    state.textContent = `${points}, computed in ${took.toFixed(took < 10 ? 1 : 0)} ms on this machine`;
    root.dataset.waited = waited.toFixed(1);
    root.dataset.runs = Number(root.dataset.runs ?? 0) + 1;
    clearTimeout(timer);
    timer = setTimeout(() => (spoken.textContent = run.error ?? `Computed: ${points}`), 700); // not at each move
  }

  find(".reset").addEventListener("click", () => {
    controls.reset();
    ask();
  });
  ask();
}

document.querySelectorAll(".model").forEach(startModelPage);
