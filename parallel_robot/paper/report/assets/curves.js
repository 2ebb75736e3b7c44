// The plot of errors over time: choice of runs and quantity, zoom by drag, values at a cursor, all by keyboard, too.

function startCurves(root) {
  const find = (selector) => root.querySelector(selector);
  const canvas = find("canvas");
  const quantity = find(".quantity");
  const logarithmic = find(".log");
  const rows = [...root.querySelectorAll("tbody tr")];
  const conditions = [...root.querySelectorAll("input[name=condition]")];
  const spoken = find("[role=status]");
  const all = { from: Math.min(...DATA.runs.map((r) => r.start)), to: Math.max(...DATA.runs.map(endTime)) };
  const state = { from: all.from, to: all.to, low: null, high: null, cursor: null, drag: null, area: null };

  const measure = () => DATA.quantities[quantity.value];
  const value = (raw) => (logarithmic.checked ? Math.log10(Math.max(Math.abs(raw), 1e-15)) : raw);
  const column = (run) => columns(run)[quantity.value];
  /** The same controller in other conditions is paler. */
  const paleness = (row) => 1 - 0.3 * conditions.findIndex((input) => input.value === row.dataset.condition);
  const chosen = () =>
    rows
      .map((row) => ({
        row,
        run: RUNS.get(row.dataset.run),
        i: Number(row.dataset.colour),
        opacity: paleness(row),
      }))
      .filter(({ row, run }) => !row.hidden && row.querySelector("input").checked && column(run));

  /** First and last row of a run inside the window of time. */
  function span(run) {
    const first = Math.max(Math.ceil((state.from - run.start) / run.step - 1e-6), 0);
    const last = Math.min(Math.floor((state.to - run.start) / run.step + 1e-6), run.rows - 1);
    return [first, last];
  }

  function extent(shownRuns) {
    if (state.low !== null) return [state.low, state.high];
    let [low, high] = [Infinity, -Infinity];
    for (const { run } of shownRuns) {
      const [first, last] = span(run);
      for (const raw of column(run).subarray(first, last + 1)) {
        if (logarithmic.checked && raw === 0) continue;
        const v = value(raw * measure().scale);
        if (v < low) low = v;
        if (v > high) high = v;
      }
    }
    if (!(high > low)) return Number.isFinite(low) ? [low - 1, low + 1] : [-1, 1];
    if (logarithmic.checked) low = Math.max(low, high - 4); // where an error passes zero it would stretch the axis without end
    const margin = 0.06 * (high - low);
    const floor = low >= 0 && low < 0.5 * high && !logarithmic.checked;
    return [floor ? 0 : low - margin, high + margin];
  }

  function draw() {
    const [c, width, height] = sized(canvas);
    if (!width) return;
    const shownRuns = chosen();
    const [low, high] = extent(shownRuns);
    const area = { left: width < 500 ? 56 : 66, right: width - 12, top: 12, bottom: height - 40, low, high };
    state.area = area;
    const x = (t) => area.left + ((t - state.from) / (state.to - state.from)) * (area.right - area.left);
    const y = (v) => area.bottom - ((v - low) / (high - low)) * (area.bottom - area.top);
    drawAxes(c, area, x, y, width);
    c.save();
    c.beginPath();
    c.rect(area.left, area.top, area.right - area.left, area.bottom - area.top);
    c.clip();
    c.lineJoin = "round";
    for (const { run, i, opacity } of shownRuns) {
      const data = column(run);
      const [first, last] = span(run);
      c.globalAlpha = opacity;
      c.strokeStyle = theme.get(`run-${i}`);
      c.lineWidth = 1.8;
      c.setLineDash(DATA.dashes[i]);
      c.beginPath();
      // a row more at either end, so that curves reach the edges
      for (let row = Math.max(first - 1, 0); row <= Math.min(last + 1, run.rows - 1); row++) {
        c.lineTo(x(run.start + row * run.step), y(value(data[row] * measure().scale)));
      }
      c.stroke();
    }
    c.globalAlpha = 1;
    c.setLineDash([]);
    if (state.cursor !== null) {
      c.strokeStyle = theme.get("ink");
      c.lineWidth = 1;
      c.beginPath();
      c.moveTo(x(state.cursor), area.top);
      c.lineTo(x(state.cursor), area.bottom);
      c.stroke();
      for (const { run, i } of shownRuns) {
        c.fillStyle = theme.get(`run-${i}`);
        c.strokeStyle = theme.get("stage");
        c.beginPath();
        c.arc(x(state.cursor), y(value(valueAt(run, quantity.value, state.cursor) * measure().scale)), 4.5, 0, 7);
        c.fill();
        c.stroke();
      }
    }
    if (state.drag) drawSelection(c, area);
    c.restore();
    fillTable();
    root.dataset.from = state.from.toFixed(3);
    root.dataset.to = state.to.toFixed(3);
    root.dataset.low = low.toPrecision(6);
    root.dataset.high = high.toPrecision(6);
    root.dataset.curves = shownRuns.length;
    root.dataset.quantity = quantity.value;
    root.dataset.cursor = state.cursor === null ? "" : state.cursor.toFixed(3);
    find(".reset").disabled = state.from === all.from && state.to === all.to && state.low === null;
  }

  function drawAxes(c, area, x, y, width) {
    c.font = `12px ${theme.get("font")}`;
    c.lineWidth = 1;
    c.strokeStyle = theme.get("grid");
    c.fillStyle = theme.get("muted");
    c.textAlign = "center";
    c.textBaseline = "top";
    const line = (x1, y1, x2, y2) => {
      c.beginPath();
      c.moveTo(x1, y1);
      c.lineTo(x2, y2);
      c.stroke();
    };
    const label = (v) => String(Number(v.toPrecision(8))).replace("-", "−");
    const power = (v) => (v > -4 && v < 5 ? label(10 ** v) : shown(10 ** v, 1));
    for (const t of ticks(state.from, state.to, width < 500 ? 4 : 9)) {
      line(x(t), area.top, x(t), area.bottom);
      c.fillText(label(t), x(t), area.bottom + 6);
    }
    c.textAlign = "right";
    c.textBaseline = "middle";
    const levels = ticks(area.low, area.high, 6);
    const whole = logarithmic.checked ? levels.filter((v) => Math.abs(v - Math.round(v)) < 1e-9) : levels;
    for (const v of whole.length > 1 ? whole : levels) {
      line(area.left, y(v), area.right, y(v));
      c.fillText(logarithmic.checked ? power(v) : label(v), area.left - 6, y(v));
    }
    if (!logarithmic.checked && area.low < 0 && area.high > 0) {
      c.strokeStyle = theme.get("muted");
      line(area.left, y(0), area.right, y(0));
    }
    const onset = Math.min(...chosen().map(({ run }) => run.onset ?? Infinity));
    if (onset > state.from && onset < state.to) {
      c.strokeStyle = theme.get("muted");
      c.setLineDash([2, 3]);
      line(x(onset), area.top, x(onset), area.bottom);
      c.setLineDash([]);
      c.textAlign = "left";
      c.textBaseline = "top";
      c.fillText("disturbance starts", x(onset) + 5, area.top + 2);
    }
    c.fillStyle = theme.get("ink");
    c.textAlign = "center";
    c.textBaseline = "bottom";
    c.fillText("time (s)", (area.left + area.right) / 2, area.bottom + 38);
    c.textBaseline = "top";
    c.save();
    c.translate(5, (area.top + area.bottom) / 2);
    c.rotate(-Math.PI / 2);
    const size = logarithmic.checked ? `magnitude of ${measure().label.toLowerCase()}` : measure().label;
    c.fillText(`${size} (${measure().unit})`, 0, 0);
    c.restore();
  }

  function drawSelection(c, area) {
    const { x0, y0, x1, y1, box } = state.drag;
    c.fillStyle = theme.get("accent");
    c.globalAlpha = 0.18;
    if (box) c.fillRect(Math.min(x0, x1), Math.min(y0, y1), Math.abs(x1 - x0), Math.abs(y1 - y0));
    else c.fillRect(Math.min(x0, x1), area.top, Math.abs(x1 - x0), area.bottom - area.top);
    c.globalAlpha = 1;
  }

  /** The table under the plot is its legend, and its values in text. */
  function fillTable() {
    const time = state.cursor;
    find(".cursor-time").textContent = time === null ? "at the cursor" : `at ${time.toFixed(2)} s`;
    for (const row of rows) {
      const run = RUNS.get(row.dataset.run);
      const cells = row.querySelectorAll("output");
      const data = column(run);
      if (row.hidden) continue;
      if (!data) {
        for (const cell of cells) cell.textContent = "–";
        continue;
      }
      const { scale } = measure();
      const [first, last] = span(run);
      let [peak, squares] = [0, 0];
      for (let k = first; k <= last; k++) {
        peak = Math.max(peak, Math.abs(data[k]));
        squares += data[k] * data[k];
      }
      cells[0].textContent = time === null ? "–" : shown(valueAt(run, quantity.value, time) * scale);
      cells[1].textContent = shown(peak * scale);
      cells[2].textContent = shown(Math.sqrt(squares / Math.max(last - first + 1, 1)) * scale);
    }
    root.querySelectorAll(".unit").forEach((element) => (element.textContent = measure().unit));
  }

  function say() {
    if (state.cursor === null) return;
    const values = chosen().map(
      ({ row, run }) =>
        `${row.dataset.name} ${shown(valueAt(run, quantity.value, state.cursor) * measure().scale)}`,
    );
    spoken.textContent = `${measure().label} in ${measure().unit} at ${state.cursor.toFixed(2)} s: ${values.join(", ")}`;
  }

  function zoom(from, to, low = null, high = null) {
    const shortest = 0.05;
    const middle = (from + to) / 2;
    const half = Math.max(to - from, shortest) / 2;
    state.from = Math.max(middle - half, all.from);
    state.to = Math.min(middle + half, all.to);
    [state.low, state.high] = [low, high];
    if (state.cursor !== null) state.cursor = Math.min(Math.max(state.cursor, state.from), state.to);
    draw();
  }

  const timeAt = (px) => {
    const { left, right } = state.area;
    return state.from + (Math.min(Math.max((px - left) / (right - left), 0), 1)) * (state.to - state.from);
  };
  const levelAt = (py) => {
    const { top, bottom, low, high } = state.area;
    return low + (Math.min(Math.max((bottom - py) / (bottom - top), 0), 1)) * (high - low);
  };

  canvas.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    canvas.setPointerCapture(event.pointerId);
    const [x, y] = [event.offsetX, event.offsetY];
    state.drag = { x0: x, y0: y, x1: x, y1: y, box: false };
  });
  canvas.addEventListener("pointermove", (event) => {
    state.cursor = timeAt(event.offsetX);
    if (state.drag) {
      state.drag.x1 = event.offsetX;
      state.drag.y1 = event.offsetY;
      // a finger scrolls the page up and down, so it zooms in time only
      state.drag.box = event.pointerType !== "touch" && Math.abs(state.drag.y1 - state.drag.y0) > 25;
    }
    draw();
  });
  canvas.addEventListener("pointerup", () => {
    const drag = state.drag;
    state.drag = null;
    if (!drag || Math.abs(drag.x1 - drag.x0) < 6) return draw();
    const times = [timeAt(drag.x0), timeAt(drag.x1)].sort((a, b) => a - b);
    const levels = drag.box ? [levelAt(drag.y0), levelAt(drag.y1)].sort((a, b) => a - b) : [null, null];
    return zoom(...times, ...levels);
  });
  canvas.addEventListener("pointercancel", () => {
    state.drag = null;
    draw();
  });
  canvas.addEventListener("pointerleave", () => {
    if (state.drag || document.activeElement === canvas) return;
    state.cursor = null;
    draw();
  });
  canvas.addEventListener("dblclick", () => zoom(all.from, all.to));
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const width = state.to - state.from;
    const cursor = state.cursor ?? (state.from + state.to) / 2;
    const step = width / (event.shiftKey ? 20 : 200);
    const moves = { ArrowLeft: cursor - step, ArrowRight: cursor + step, Home: state.from, End: state.to };
    if (event.key in moves) {
      state.cursor = Math.min(Math.max(moves[event.key], state.from), state.to);
      draw();
      say();
    } else if (event.key === "+" || event.key === "=") zoom(cursor - width / 4, cursor + width / 4);
    else if (event.key === "-") zoom(cursor - width, cursor + width);
    else if (event.key === "Escape" || event.key === "0") zoom(all.from, all.to);
    else return;
    event.preventDefault();
  });

  function chooseRuns() {
    const wanted = conditions.filter((input) => input.checked).map((input) => input.value);
    for (const row of rows) {
      row.hidden = !wanted.includes(row.dataset.condition);
      row.querySelector(".sample").style.opacity = paleness(row);
    }
    root.classList.toggle("several", wanted.length > 1);
    draw();
  }
  for (const input of conditions) input.addEventListener("change", chooseRuns);
  for (const input of root.querySelectorAll("tbody input")) input.addEventListener("change", draw);
  quantity.addEventListener("change", () => zoom(state.from, state.to));
  logarithmic.addEventListener("change", () => zoom(state.from, state.to));
  find(".reset").addEventListener("click", () => zoom(all.from, all.to));
  find(".steady").addEventListener("click", (event) => zoom(Number(event.target.dataset.from), all.to));
  keepPainted(canvas, draw);
  chooseRuns();
}

document.querySelectorAll(".curves").forEach(startCurves);
