// The diagram of the system: boxes where an SSP has placed them, else laid out by dagre; arrows for bundles of connections.

function startDiagram(root) {
  const { components, bundles, places } = DATA.diagram;
  const picture = root.querySelector(".diagram");
  const chosen = root.querySelector(".chosen");
  const short = (text) => (text.length > 34 ? `${text.slice(0, 16)}…${text.slice(-16)}` : text);
  const plan = places ? placed() : fitting();

  /** From left to right; from top to bottom where that is narrower and the page is too. */
  function fitting() {
    const across = laidOut("LR");
    if (across.width <= picture.clientWidth - 20) return across;
    const down = laidOut("TB");
    return down.width < across.width ? down : across;
  }

  /** Boxes {x, y, width, height} of components by name, and points of each bundle, as dagre arranges them. */
  function laidOut(rankdir) {
    const graph = new dagre.graphlib.Graph({ multigraph: true });
    graph.setGraph({ rankdir, nodesep: 36, ranksep: 56, edgesep: 26, marginx: 14, marginy: 14 });
    graph.setDefaultEdgeLabel(() => ({}));
    for (const c of components) graph.setNode(c.name, { width: widthOf(c), height: 58 });
    bundles.forEach((b, i) => {
      if (b.from !== b.to) graph.setEdge(b.from, b.to, { width: 30, height: 22, labelpos: "c", i }, String(i));
    });
    dagre.layout(graph, { disableOptimalOrderHeuristic: components.length > 150 });
    const boxes = new Map(components.map((c) => [c.name, graph.node(c.name)]));
    const lines = bundles.map((b, i) => (b.from === b.to ? loop(boxes.get(b.from)) : graph.edge(b.from, b.to, String(i)).points));
    return { boxes, lines, width: graph.graph().width };
  }

  function widthOf(c) {
    return Math.max(96, 9 * short(c.name).length + 26, 6.8 * short(c.about).length + 20);
  }

  /** As the SSP has it: millimetres, y up. */
  function placed() {
    const corners = components.map((c) => places[c.name]);
    const left = Math.min(...corners.map((g) => Math.min(g[0], g[2])));
    const top = Math.max(...corners.map((g) => Math.max(g[1], g[3])));
    const widest = Math.max(...components.map((c, i) => widthOf(c) / Math.max(Math.abs(corners[i][2] - corners[i][0]), 1e-9)));
    const highest = Math.max(...corners.map((g) => 48 / Math.max(Math.abs(g[3] - g[1]), 1e-9)));
    const extent = Math.max(...corners.map((g) => Math.max(g[0], g[2]))) - left;
    const scale = Math.min(Math.max(widest, highest), 3000 / Math.max(extent, 1e-9));
    const boxes = new Map(
      components.map((c, i) => {
        const [x1, y1, x2, y2] = corners[i];
        return [c.name, {
          x: scale * ((x1 + x2) / 2 - left), y: scale * (top - (y1 + y2) / 2),
          width: scale * Math.abs(x2 - x1), height: scale * Math.abs(y2 - y1),
        }];
      }),
    );
    const lines = bundles.map((b, i) => (b.from === b.to ? loop(boxes.get(b.from)) : straight(boxes.get(b.from), boxes.get(b.to), i)));
    return { boxes, lines };
  }

  function loop({ x, y, width, height }) {
    const [right, bottom] = [x + width / 2, y + height / 2];
    return [{ x: right, y }, { x: right + 22, y }, { x: right + 22, y: bottom + 18 }, { x, y: bottom + 18 }, { x, y: bottom }];
  }

  /** From rim to rim, bent a little so that the way back is another line. */
  function straight(a, b, i) {
    const [dx, dy] = [b.x - a.x, b.y - a.y];
    const far = Math.hypot(dx, dy) || 1;
    const bend = bundles.some((o, k) => k !== i && o.from === bundles[i].to && o.to === bundles[i].from) ? 26 : 0;
    const middle = { x: a.x + dx / 2 - (bend * dy) / far, y: a.y + dy / 2 + (bend * dx) / far };
    return [rim(a, middle), middle, rim(b, middle)];
  }

  function rim(box, to) {
    const [dx, dy] = [to.x - box.x, to.y - box.y];
    const part = Math.min(box.width / 2 / Math.max(Math.abs(dx), 1e-9), box.height / 2 / Math.max(Math.abs(dy), 1e-9), 1);
    return { x: box.x + part * dx, y: box.y + part * dy };
  }

  const svg = make("svg", { role: "group", "aria-label": "Components and connections" });
  picture.append(svg);

  function path(points) {
    if (points.length === 3) {
      const [a, m, b] = points;
      const control = { x: 2 * m.x - (a.x + b.x) / 2, y: 2 * m.y - (a.y + b.y) / 2 };
      return `M${a.x} ${a.y}Q${control.x} ${control.y} ${b.x} ${b.y}`;
    }
    const [first, ...rest] = points;
    let text = `M${first.x} ${first.y}`;
    for (let k = 0; k < rest.length - 1; k++) {
      const end = k === rest.length - 2 ? rest[k + 1] : { x: (rest[k].x + rest[k + 1].x) / 2, y: (rest[k].y + rest[k + 1].y) / 2 };
      text += `Q${rest[k].x} ${rest[k].y} ${end.x} ${end.y}`;
    }
    return rest.length > 1 ? text : `${text}L${rest[0].x} ${rest[0].y}`;
  }

  function tip(points) {
    const [b, a] = [points.at(-1), points.at(-2)];
    const angle = Math.atan2(b.y - a.y, b.x - a.x);
    const corner = (turn) => `${b.x - 10 * Math.cos(angle + turn)} ${b.y - 10 * Math.sin(angle + turn)}`;
    return `M${b.x} ${b.y}L${corner(0.42)}L${corner(-0.42)}Z`;
  }

  function button(element, name, act) {
    element.setAttribute("role", "button");
    element.setAttribute("tabindex", "0");
    element.setAttribute("aria-label", name);
    element.setAttribute("aria-pressed", "false");
    const choose = () => {
      for (const other of svg.querySelectorAll("[aria-pressed=true]")) other.setAttribute("aria-pressed", "false");
      element.setAttribute("aria-pressed", "true");
      act();
    };
    element.addEventListener("click", choose);
    element.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      choose();
    });
    return element;
  }

  const list = (heading, texts) => {
    chosen.replaceChildren(make("h3", {}, heading), make("ul", {}, ...texts.map((t) => make("li", {}, make("code", {}, t)))));
  };
  const count = (n) => `${n} connection${n === 1 ? "" : "s"}`;

  bundles.forEach((bundle, i) => {
    const points = plan.lines[i];
    const d = path(points);
    const n = bundle.pairs.length;
    const wire = make("path", { class: "wire", d });
    const group = make("g", {}, make("path", { class: "catch", d }), wire, make("path", { class: "tip", d: tip(points) }));
    svg.append(group);
    const middle = wire.getPointAtLength(wire.getTotalLength() / 2);
    group.append(
      make("rect", { class: "pad", x: middle.x - 13, y: middle.y - 13, width: 26, height: 26, rx: 6 }),
      make("text", { class: "count", x: middle.x, y: middle.y + 4 }, String(n)),
    );
    const pairs = bundle.pairs.map(([a, b]) => (a === b ? a : `${a} → ${b}`));
    const name = `${bundle.from} to ${bundle.to}: ${count(n)}`;
    svg.append(button(group, name, () => list(`${bundle.from} → ${bundle.to}: ${count(n)}`, pairs)));
  });
  for (const c of components) {
    const box = plan.boxes.get(c.name);
    const group = make(
      "g",
      {},
      make("rect", { class: "box", x: box.x - box.width / 2, y: box.y - box.height / 2, width: box.width, height: box.height, rx: 7 }),
      make("text", { x: box.x, y: box.y + (c.about ? -3 : 5) }, short(c.name)),
      make("text", { class: "about", x: box.x, y: box.y + 15 }, short(c.about)),
    );
    const wires = bundles.filter((b) => b.from === c.name || b.to === c.name);
    const texts = [
      ...wires.flatMap((b) => b.pairs.map(([a, z]) => (b.to === c.name ? `${z} ← ${b.from}.${a}` : `${a} → ${b.to}.${z}`))),
      ...c.signals.map((s) => `${s} ← input signal`),
    ];
    svg.append(
      button(group, `Component ${c.name}`, () => {
        list(c.name, texts);
        document.dispatchEvent(new CustomEvent("component", { detail: c.name }));
      }),
    );
    if (c.signals.length) {
      const [x, y] = [box.x, box.y - box.height / 2];
      svg.append(make("path", { class: "wire", d: `M${x} ${y - 20}V${y}` }), make("path", { class: "tip", d: tip([{ x, y: y - 20 }, { x, y }]) }));
    }
  }
  const whole = svg.getBBox();
  const [width, height] = [whole.width + 16, whole.height + 16];
  svg.setAttribute("viewBox", `${whole.x - 8} ${whole.y - 8} ${width} ${height}`);
  svg.setAttribute("width", width);
  svg.setAttribute("height", height);
}

// It needs sizes of texts, which a frame has only once it is shown.
new ResizeObserver((entries, observer) => {
  if (!entries[0].contentRect.width) return;
  observer.disconnect();
  startDiagram(document.getElementById("system"));
}).observe(document.querySelector("#system .diagram"));
