// Errors, torques and estimates of all runs over time: one plot, whose legend is a table.

function startErrors(root) {
  const { quantities, dashes } = DATA.errors;
  const find = (selector) => root.querySelector(selector);
  const quantity = find(".quantity");
  const logarithmic = find(".log");
  const rows = [...root.querySelectorAll("tbody tr")];
  const conditions = [...root.querySelectorAll("input[name=condition]")];
  const runs = rows.map((row) => MOTIONS.get(row.dataset.run));
  const grids = new Map(); // equal times are one array
  const times = runs.map(({ start, step, rows: n }) => {
    const key = `${start} ${step} ${n}`;
    if (!grids.has(key)) grids.set(key, Float64Array.from({ length: n }, (_, i) => start + i * step));
    return grids.get(key);
  });
  const view = new TimeView(Math.min(...runs.map((r) => r.start)), Math.max(...runs.map(endTime)));
  const measure = () => quantities[quantity.value];

  /** Curves of one condition are solid, those of further ones paler. */
  function alpha(row) {
    const wanted = conditions.filter((input) => input.checked).map((input) => input.value);
    return [1, 0.6, 0.35][Math.max(wanted.indexOf(row.dataset.condition), 0)];
  }

  function series() {
    return rows.flatMap((row, k) => {
      const column = runs[k].columns[quantity.value];
      if (!column || row.hidden || !row.querySelector("input").checked) return [];
      const colour = Number(row.dataset.colour);
      return {
        row: k,
        label: row.dataset.name,
        times: times[k],
        values: Float64Array.from(column, (v) => v * measure().scale),
        colour,
        dash: dashes[colour],
        alpha: alpha(row),
      };
    });
  }

  function events() {
    const onsets = new Set(rows.flatMap((row, k) => (row.hidden || runs[k].onset === null ? [] : runs[k].onset)));
    return [...onsets].map((time) => ({ time, text: "disturbance starts" }));
  }

  const settings = () => {
    const { label, unit } = measure();
    const title = logarithmic.checked ? `Magnitude of ${label.toLowerCase()}` : label;
    return { title, unit, series: series(), events: events(), log: logarithmic.checked };
  };
  const plot = new Plot(find(".curves"), view, { ...settings(), say: false, named: true, height: 360 });

  function redraw() {
    for (const row of rows) {
      row.hidden = !conditions.some((input) => input.checked && input.value === row.dataset.condition);
      row.querySelector(".sample").setAttribute("opacity", alpha(row));
    }
    root.classList.toggle("several", conditions.filter((input) => input.checked).length > 1);
    plot.set(settings());
    root.dataset.curves = plot.settings.series.length;
    root.dataset.quantity = quantity.value;
    fill();
  }

  function fill() {
    const time = view.cursor;
    find(".cursor-time").textContent = time === null ? "at the cursor" : `at ${time.toFixed(2)} s`;
    const drawn = new Map(plot.settings.series.map((s) => [s.row, s]));
    rows.forEach((row, k) => {
      const cells = row.querySelectorAll("output");
      const curve = drawn.get(k);
      if (!curve) {
        for (const cell of cells) cell.textContent = "–";
        return;
      }
      const [first, last] = [rowAt(curve.times, view.from), rowAt(curve.times, view.to)];
      let [peak, squares] = [0, 0];
      for (let i = first; i <= last; i++) {
        peak = Math.max(peak, Math.abs(curve.values[i]));
        squares += curve.values[i] ** 2;
      }
      cells[0].textContent = time === null ? "–" : shown(valueAt(curve, time), 3);
      cells[1].textContent = shown(peak, 3);
      cells[2].textContent = shown(Math.sqrt(squares / Math.max(last - first + 1, 1)), 3);
    });
    root.querySelectorAll(".unit").forEach((element) => (element.textContent = measure().unit));
    root.dataset.from = view.from.toFixed(3);
    root.dataset.to = view.to.toFixed(3);
    root.dataset.cursor = time === null ? "" : time.toFixed(3);
    find(".reset").disabled = view.isWhole;
  }

  for (const input of [...conditions, ...root.querySelectorAll("tbody input"), quantity, logarithmic]) {
    input.addEventListener("change", redraw);
  }
  find(".reset").addEventListener("click", () => view.showAll());
  find(".steady").addEventListener("click", (event) => view.zoom(Number(event.target.dataset.from), view.all.to));
  view.follow(fill);
  redraw();
}

Promise.all(ROBOT.runs.map(prepared)).then(() => document.querySelectorAll(".errors").forEach(startErrors));
