// All curves of a page in panels, each drawn when it comes into view; search, grouping, and a time range they share.

const MOST_LINES = 8; // in a panel; larger vectors have several
const MOST_PANELS = 60; // made at once; more when the reader asks

function startSignals(root) {
  const find = (selector) => root.querySelector(selector);
  const { runs, variables } = DATA.curves;
  const several = runs.length > 1;
  const asks = location.protocol.startsWith("http") && document.querySelector("meta[content*=connect-src]") !== null;
  const view = new TimeView(Math.min(...runs.map((r) => r.ends[0])), Math.max(...runs.map((r) => r.ends[1])));
  const times = runs.map((run) => timesOf(run.time));
  const events = new Map(); // by time and text: those of several runs are drawn once
  DATA.events.forEach((list, k) => {
    for (const { time, text } of list) {
      const key = `${time} ${text}`;
      events.set(key, { time, text, runs: [...(events.get(key)?.runs ?? []), runs[k].label] });
    }
  });
  const drawn = [...events.values()].map(({ time, text, runs: own }) => ({
    time,
    text: own.length === runs.length ? text : `${own.join(", ")}: ${text}`,
  }));
  const component = (variable) => {
    const dot = variable.name.lastIndexOf(".", variable.name.indexOf("[") < 0 ? undefined : variable.name.indexOf("["));
    return dot < 0 ? "" : variable.name.slice(0, dot);
  };

  /** Panels: title, unit, and curves as [variable, number of its column, label]. */
  const groupings = {
    variable: () => variables.flatMap((v) => split(v.name, v.unit, v.columns.map((_, i) => [v, i]))),
    difference: () => {
      const far = (panel) => panel.curves[0][0].difference ?? -1;
      return groupings.variable().sort((a, b) => far(b) - far(a));
    },
    unit: () => {
      const units = new Map();
      for (const v of variables) {
        const key = v.unit || "without unit";
        if (!units.has(key)) units.set(key, []);
        units.get(key).push(...v.columns.map((_, i) => [v, i]));
      }
      return [...units].flatMap(([unit, curves]) => split(unit, unit === "without unit" ? "" : unit, curves, true));
    },
  };
  function split(title, unit, curves, named = false) {
    const parts = Math.ceil(curves.length / MOST_LINES);
    const each = Math.ceil(curves.length / parts);
    return Array.from({ length: parts }, (_, k) => {
      const own = curves.slice(k * each, (k + 1) * each);
      return { title: parts > 1 ? `${title} (${k + 1} of ${parts})` : title, unit, curves: own, named };
    });
  }
  const label = (panel, [variable, i]) => {
    const column = variable.columns[i];
    if (several) return runs[column.run].label;
    if (!panel.named) return column.label;
    return column.label.startsWith("[") ? variable.name + column.label : variable.name;
  };

  const box = find(".panels");
  const made = new Map();
  const watcher = new IntersectionObserver(
    (entries) => {
      for (const { isIntersecting, target } of entries) {
        if (!isIntersecting) continue;
        watcher.unobserve(target);
        draw(target, made.get(target));
      }
    },
    { rootMargin: "200px" },
  );

  async function draw(element, panel) {
    const series = await Promise.all(
      panel.curves.map(async (curve, k) => {
        const [variable, i] = curve;
        const columns = await columnsOf(variable.block, variable.columns);
        const { run } = variable.columns[i];
        return {
          label: label(panel, curve),
          times: await times[run],
          values: columns[i],
          stepped: variable.stepped,
          colour: several ? run : k,
        };
      }),
    );
    const plot = new Plot(element.querySelector(".curves"), view, { title: panel.title, unit: panel.unit, series, events: drawn });
    if (asks && panel.curves.some(([v, i]) => runs[v.columns[i].run].resolution)) askFor(plot, panel, series);
    if (several && series.length > 1) drawDifferences(element, panel, series);
    element.dataset.drawn = "yes";
  }

  /** Ask the server for the values in view that the page has no room for, a moment after a zoom. */
  function askFor(plot, panel, whole) {
    let timer = null;
    let last = "";
    view.follow(() => {
      const key = `${view.from} ${view.to}`;
      if (key === last || !view.plots.has(plot)) return;
      last = key;
      clearTimeout(timer);
      if (view.isWhole) {
        if (plot.settings.series !== whole) plot.set({ series: whole });
        return;
      }
      timer = setTimeout(async () => {
        const names = panel.curves.map(([v, i]) => `${v.columns[i].run}:${v.columns[i].name}`).join("\n");
        const answer = await fetch(`detail?${new URLSearchParams({ names, from: view.from, to: view.to })}`);
        if (!answer.ok || key !== last) return;
        const found = await answer.json();
        const columns = columnsIn(await inflatedText(found.bytes), found.curves);
        const grids = await Promise.all(
          found.curves.map(async ({ time }, k) =>
            timesOf(found.times[k] ? { ...time, block: await inflatedText(found.times[k]) } : time),
          ),
        );
        const equal = found.curves.every(({ time }) => JSON.stringify(time) === JSON.stringify(found.curves[0].time));
        const shared = equal && !found.times[0];
        plot.set({ series: whole.map((s, k) => ({ ...s, times: shared ? grids[0] : grids[k], values: columns[k] })) });
        plot.root.dataset.resolution = found.curves[0].resolution ?? "all";
      }, 200);
    });
  }

  /** Below the curves of several runs: how far each is from the first. */
  function drawDifferences(element, panel, series) {
    const [first, ...others] = series;
    const differences = others.map((s) => ({
      ...s,
      label: `${s.label} − ${first.label}`,
      values: Array.from(s.times, (t, row) => {
        const [a, b] = [s.values[row], valueAt(first, t)];
        return a === null || b === null ? null : a - b;
      }),
    }));
    const title = `Difference of ${panel.title} from that of ${first.label}`;
    new Plot(element.querySelector(".differences"), view, { title, unit: panel.unit, series: differences, height: 130 });
  }

  /** How far the curves of several runs are from the first, in words. */
  function far(panel) {
    const { difference } = panel.curves[0][0];
    if (!several || difference === null) return "";
    const text = difference === 0 ? "· equal" : `· differ by ${shown(100 * difference, 3)} % of the range`;
    return make("small", {}, text);
  }

  let panels = [];
  let wanted = MOST_PANELS;

  function show() {
    const words = find(".search").value.toLowerCase().split(/\s+/).filter(Boolean);
    const only = find(".component").value;
    const fits = (curve, panel) => {
      const name = `${panel.title} ${curve[0].name}${curve[0].columns[curve[1]].label} ${panel.unit}`.toLowerCase();
      const own = component(curve[0]);
      return (!only || own === only || own.startsWith(`${only}.`)) && words.every((word) => name.includes(word));
    };
    panels = groupings[find(".grouping").value]().filter((panel) => {
      if (panel.named) panel.curves = panel.curves.filter((curve) => fits(curve, panel));
      return panel.curves.some((curve) => fits(curve, panel));
    });
    view.plots.clear();
    for (const element of made.keys()) watcher.unobserve(element);
    made.clear();
    box.replaceChildren();
    more();
  }

  function more() {
    for (const panel of panels.slice(made.size, wanted)) {
      const unit = panel.unit && panel.unit !== panel.title ? make("small", {}, panel.unit) : "";
      const element = make("div", { class: "panel" }, make("h3", {}, panel.title.trim() || "(without a name)", " ", unit, " ", far(panel)));
      element.append(make("div", { class: "curves" }));
      if (several && panel.curves.length > 1) element.append(make("div", { class: "differences" }));
      element.querySelector(".curves").style.minHeight = "262px"; // so that panels further down are not in view yet
      made.set(element, panel);
      box.append(element);
      watcher.observe(element);
    }
    const left = panels.length - made.size;
    const found = find(".found");
    const still = panels.filter((panel) => panel.curves.every(([v]) => v.still)).length;
    const said = still && still < panels.length ? `; in ${still} nothing changes` : "";
    found.textContent = `${panels.length} panel${panels.length === 1 ? "" : "s"}${said}`;
    if (left > 0) {
      const button = make("button", { type: "button" }, `Show ${Math.min(left, MOST_PANELS)} more`);
      button.addEventListener("click", () => {
        wanted += MOST_PANELS;
        button.remove();
        more();
      });
      box.after(button);
      root.querySelectorAll(".panels ~ button").forEach((b) => b !== button && b.remove());
    } else root.querySelectorAll(".panels ~ button").forEach((b) => b.remove());
  }

  find(".grouping").append(make("option", { value: "variable" }, "by variable"));
  const further = several ? ["difference", "by difference, largest first"] : ["unit", "by unit"];
  find(".grouping").append(make("option", { value: further[0] }, further[1]));
  const components = [...new Set(variables.map((v) => component(v).split(".")[0]))].filter(Boolean);
  find(".component").append(...components.map((name) => make("option", { value: name }, name)));
  find(".of-component").hidden = components.length < 2;
  for (const name of [".grouping", ".component"]) {
    find(name).addEventListener("change", () => {
      wanted = MOST_PANELS;
      show();
    });
  }
  let waiting;
  find(".search").addEventListener("input", () => {
    clearTimeout(waiting);
    waiting = setTimeout(show, 150);
  });
  const acts = {
    in: () => view.magnify(2),
    out: () => view.magnify(0.5),
    left: () => view.shift(-0.5),
    right: () => view.shift(0.5),
    all: () => view.showAll(),
  };
  for (const button of root.querySelectorAll("[data-act]")) {
    button.addEventListener("click", acts[button.dataset.act]);
  }
  view.follow(() => {
    const at = view.cursor === null ? "" : ` at ${view.text(view.cursor)} s`;
    find(".range").textContent = `${view.text(view.from)} to ${view.text(view.to)} s${at}`;
    for (const name of ["out", "left", "right", "all"]) find(`[data-act=${name}]`).disabled = view.isWhole;
    root.dataset.from = view.from;
    root.dataset.to = view.to;
  });
  view.changed();
  for (const button of document.querySelectorAll("button.moment")) {
    button.addEventListener("click", () => {
      const time = Number(button.dataset.time);
      const width = 0.1 * (view.all.to - view.all.from);
      root.scrollIntoView();
      view.zoom(time - width / 2, time + width / 2);
      view.point(time);
    });
  }
  document.addEventListener("component", ({ detail }) => {
    if (![...find(".component").options].some((o) => o.value === detail)) return;
    find(".component").value = detail;
    show();
  });
  show();
  window.signals = view; // for who looks at the page in the console
}

startSignals(document.getElementById("signals"));
