// Runs of a sweep as a scatter plot and a table, those of the page and those that come from its server.

const EVERY = 500; // ms between two drawings of a sweep that goes on
const PARTS = 5; // a number with more values than there are colours is told by so many ranges

function startSweep() {
  const { factors, metrics, points, ended, runs } = DATA.sweep;
  const names = [...factors, ...metrics];
  const indices = [];
  const columns = names.map(() => []);
  const errors = new Map(); // row -> text
  const find = (selector) => document.querySelector(selector);
  const [across, up, colour] = ["across", "up", "colour"].map((kind) => find(`select.${kind}`));
  const now = document.getElementById("now");
  const bar = document.getElementById("done");
  let changed = false;

  function add({ index, columns: more, errors: why }) {
    for (const [k, text] of Object.entries(why)) errors.set(indices.length + Number(k), text);
    indices.push(...index);
    columns.forEach((column, j) => column.push(...more[j]));
    changed = true;
  }

  // ---- the scatter plot

  const option = (name) => make("option", { value: name }, name);
  across.append(...names.map(option));
  up.append(...[...metrics, ...factors].map(option));
  colour.append(make("option", { value: "" }, "none"), ...names.map(option));
  colour.value = factors[1] ?? "";

  const isText = (column) => column.some((v) => typeof v === "string");
  const levelsOf = (column) => [...new Set(column.filter((v) => v !== null))];
  const said = (v) => (typeof v === "number" ? shown(v) : v === null ? "–" : String(v));

  /** A column as numbers, with the texts that they stand for. */
  function numbers(name) {
    const column = columns[names.indexOf(name)] ?? [];
    if (!isText(column)) return { values: column, labels: null };
    const labels = levelsOf(column).map(String);
    return { values: column.map((v) => (v === null ? null : labels.indexOf(String(v)))), labels };
  }

  /** Number of the group of each row, and what the groups are. */
  function groupsOf(name) {
    const column = columns[names.indexOf(name)];
    if (!column) return { group: indices.map(() => 0), groups: ["all"] };
    const levels = levelsOf(column);
    if (levels.length <= COLOURS) {
      if (!isText(column)) levels.sort((a, b) => a - b);
      const place = new Map(levels.map((v, k) => [v, k]));
      return { group: column.map((v) => place.get(v) ?? 0), groups: levels.map((v) => `${name} = ${said(v)}`) };
    }
    if (isText(column)) return { group: column.map((v) => levels.indexOf(v) % COLOURS), groups: ["many texts"] };
    const sorted = levels.sort((a, b) => a - b);
    const ends = Array.from({ length: PARTS }, (_, k) => sorted[Math.floor((k * sorted.length) / PARTS)]);
    const part = (v) => Math.max(ends.findLastIndex((end) => v >= end), 0);
    const upper = (k) => (k + 1 < PARTS ? `below ${said(ends[k + 1])}` : said(sorted.at(-1)));
    return { group: column.map(part), groups: ends.map((end, k) => `${name}: ${said(end)} to ${upper(k)}`) };
  }

  const scatter = new Scatter(find(".scatter"), (row) => {
    const pairs = names.map((name, j) => make("div", {}, make("dt", {}, name), make("dd", {}, said(columns[j][row]))));
    const why = errors.has(row) ? [make("p", {}, errors.get(row))] : [];
    find(".chosen").replaceChildren(make("h3", {}, `Run ${indices[row]}`), ...why, make("dl", {}, ...pairs));
    marked = row;
    showTable();
  });

  function showScatter() {
    const [x, y] = [numbers(across.value), numbers(up.value)];
    for (const [kind, { labels }] of [["across", x], ["up", y]]) find(`.log-${kind}`).disabled = labels !== null;
    const axis = (kind, select, { labels }) => ({
      name: select.value,
      log: labels === null && find(`.log-${kind}`).checked,
      labels,
    });
    scatter.set({
      x: x.values,
      y: y.values,
      ...groupsOf(colour.value),
      across: axis("across", across, x),
      up: axis("up", up, y),
    });
  }
  for (const control of [across, up, colour, find(".log-across"), find(".log-up")])
    control.addEventListener("change", showScatter);

  // ---- the table

  const sorting = { column: null, down: false };
  let wanted = 25;
  let marked = -1;
  const heads = ["run", ...names, "error"].map((name, j) => {
    const button = make("button", { type: "button" }, name);
    const head = make("th", { scope: "col" }, button);
    button.addEventListener("click", () => {
      sorting.down = sorting.column === j && !sorting.down;
      sorting.column = j;
      for (const other of heads) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", sorting.down ? "descending" : "ascending");
      showTable();
    });
    return head;
  });
  find(".runs-table thead tr").append(...heads);

  const valueIn = (row, j) => (j === 0 ? indices[row] : j > names.length ? (errors.get(row) ?? null) : columns[j - 1][row]);

  function order(a, b) {
    const [u, v] = [valueIn(a, sorting.column), valueIn(b, sorting.column)];
    if (u === null || v === null) return (u === null) - (v === null); // what is missing comes last
    const sign = sorting.down ? -1 : 1;
    return sign * (typeof u === "string" || typeof v === "string" ? String(u).localeCompare(String(v)) : u - v);
  }

  function showTable() {
    let rows = Array.from(indices.keys());
    if (find(".failed-only").checked) rows = rows.filter((row) => errors.has(row));
    if (sorting.column === null) rows.reverse(); // the latest first
    else rows.sort(order);
    find(".found").textContent = `${rows.length.toLocaleString("en")} run${rows.length === 1 ? "" : "s"}`;
    find(".more").hidden = rows.length <= wanted;
    find(".runs-table tbody").replaceChildren(
      ...rows.slice(0, wanted).map((row) => {
        const cells = names.map((_, j) => make("td", {}, said(columns[j][row])));
        const why = make("td", { class: "why" }, errors.get(row) ?? "");
        const failed = errors.has(row) ? [" ", make("span", { class: "badge bad" }, "failed")] : [];
        const head = make("th", { scope: "row" }, String(indices[row]), ...failed);
        return make("tr", { class: row === marked ? "marked" : null }, head, ...cells, why);
      }),
    );
  }
  find(".failed-only").addEventListener("change", showTable);
  find(".more").addEventListener("click", () => {
    wanted *= 4;
    showTable();
  });

  function show() {
    if (!changed) return;
    changed = false;
    showScatter();
    showTable();
  }

  // ---- what comes

  function told({ done, failed, workers }) {
    bar.value = done;
    const failures = failed ? `, ${failed.toLocaleString("en")} failed` : "";
    const by = workers === undefined ? "" : workers ? `, ${workers} worker${workers === 1 ? "" : "s"}` : ", waiting for workers";
    now.textContent = `${done.toLocaleString("en")} of ${points.toLocaleString("en")} runs${failures}${by}`;
  }

  if (runs) add(runs);
  show();
  if (ended) {
    told({ done: ended[0], failed: ended[1] });
    return;
  }
  const state = document.getElementById("state");
  const say = (text, kind) => {
    state.textContent = text;
    state.className = `badge ${kind}`;
  };
  setInterval(show, EVERY);
  const stream = new EventSource("rows");
  stream.onerror = () => say("the program has ended", "part");
  stream.onmessage = (event) => {
    const message = JSON.parse(event.data);
    if (message.runs) add(message.runs);
    if (message.progress) told(message.progress);
    if (message.state) {
      say(message.state, message.state === "completed" ? "good" : message.state === "running" ? "open" : "part");
      if (message.state !== "running") stream.close();
    }
  };
}

startSweep();
