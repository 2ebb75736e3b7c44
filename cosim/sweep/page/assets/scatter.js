// A scatter plot of many points, drawn by uPlot: colours by group, the nearest point to the pointer, all by keyboard, too.

const NEAR = 14; // pixels within which a point is meant

class Scatter {
  /** `chosen(row)` is called with the row of a point that the reader has chosen. */
  constructor(root, chosen) {
    this.area = make("div", { class: "plot-area", tabindex: "0", role: "application" });
    this.legend = make("ul", { class: "plot-legend" });
    root.append(this.area, this.legend);
    this.chosen = chosen;
    this.at = -1; // position of the chosen point among those in order
    this.order = [];
    new ResizeObserver(() => this.resized()).observe(this.area);
    theme.follow(() => this.uplot?.redraw(false));
    this.area.addEventListener("keydown", (event) => this.pressed(event));
  }

  /** Points: `x` and `y` with null where there is none, `group` of each, and names of the groups; axes {name, log, labels}. */
  set(points) {
    const { x, y, across, up } = points;
    const usable = (v, { log }) => v !== null && (!log || v > 0);
    const row = this.at >= 0 ? this.order[this.at] : -1;
    this.points = points;
    this.order = Array.from(x.keys()).filter((i) => usable(x[i], across) && usable(y[i], up));
    this.order.sort((a, b) => x[a] - x[b] || y[a] - y[b]);
    this.at = this.order.indexOf(row);
    this.area.setAttribute(
      "aria-label",
      `${up.name} over ${across.name}, ${this.order.length} points. Arrow keys go from point to point.`,
    );
    this.legend.replaceChildren(
      ...(points.groups.length > 1 ? points.groups : []).map((name, k) =>
        make("li", {}, make("span", { class: `swatch line-${k % COLOURS}`, "aria-hidden": "true" }), make("span", {}, name)),
      ),
    );
    this.build();
  }

  build() {
    this.uplot?.destroy();
    this.uplot = null;
    const width = this.area.clientWidth;
    if (!width || !this.points) return;
    const { x, y, group, groups, across, up } = this.points;
    const value = (v, { log }) => (log ? Math.log10(v) : v);
    const columns = groups.map(() => new Array(this.order.length).fill(null));
    const times = this.order.map((i) => value(x[i], across));
    this.order.forEach((i, k) => (columns[group[i]][k] = value(y[i], up)));
    const ink = () => theme.get("muted");
    const grid = { stroke: () => theme.get("grid"), width: 1 };
    const axis = { stroke: ink, grid, ticks: { ...grid, size: 4 }, font: `12px ${theme.get("font")}`, gap: 4 };
    const ticks = ({ log, labels }) => (u, list) =>
      list.map((v) => (labels ? (labels[v] ?? "") : log ? power(v) : v === null ? "" : tick(v)));
    const scale = { time: false, range: (u, low, high) => margins(low, high, false) };
    const size = this.order.length > 3000 ? 3 : this.order.length > 300 ? 5 : 8;
    this.uplot = new uPlot(
      {
        width,
        height: 380,
        padding: [12, 20, 0, 0],
        legend: { show: false },
        scales: { x: scale, y: scale },
        axes: [
          { ...axis, label: across.name, labelSize: 20, labelGap: 0, labelFont: axis.font, size: 28, values: ticks(across) },
          {
            ...axis,
            label: up.name,
            labelSize: 20,
            labelGap: 0,
            labelFont: axis.font,
            values: ticks(up),
            size: (u, values) => 14 + 7 * Math.max(3, ...(values ?? []).map((v) => v.length)),
          },
        ],
        cursor: { drag: { x: false, y: false }, points: { show: false }, x: false, y: false },
        series: [
          {},
          ...columns.map((_, k) => {
            const colour = () => theme.get(`line-${k % COLOURS}`);
            return { stroke: colour, paths: () => null, points: { show: true, size, stroke: colour, fill: colour, width: 0 } };
          }),
        ],
        hooks: { draw: [(u) => this.drawChosen(u)] },
      },
      [times, ...columns],
      this.area,
    );
    const over = this.uplot.over;
    over.addEventListener("click", (event) => {
      const box = over.getBoundingClientRect();
      this.choose(this.nearest(event.clientX - box.left, event.clientY - box.top));
    });
    this.area.dataset.points = this.order.length;
  }

  /** Where a point is in the plot, in pixels of the page or of the canvas. */
  place(k, canvas = false) {
    const { x, y, across, up } = this.points;
    const i = this.order[k];
    const value = (v, { log }) => (log ? Math.log10(v) : v);
    return [this.uplot.valToPos(value(x[i], across), "x", canvas), this.uplot.valToPos(value(y[i], up), "y", canvas)];
  }

  nearest(left, top) {
    let [best, least] = [-1, NEAR ** 2];
    for (let k = 0; k < this.order.length; k++) {
      const [x, y] = this.place(k);
      const far = (x - left) ** 2 + (y - top) ** 2;
      if (far < least) [best, least] = [k, far];
    }
    return best;
  }

  choose(k) {
    if (k < 0) return;
    this.at = k;
    this.uplot.redraw(false);
    this.chosen(this.order[k]);
  }

  drawChosen(u) {
    if (this.at < 0) return;
    const [x, y] = this.place(this.at, true);
    u.ctx.save();
    u.ctx.strokeStyle = theme.get("ink");
    u.ctx.lineWidth = 2 * devicePixelRatio;
    u.ctx.beginPath();
    u.ctx.arc(x, y, 8 * devicePixelRatio, 0, 2 * Math.PI);
    u.ctx.stroke();
    u.ctx.restore();
  }

  pressed(event) {
    const last = this.order.length - 1;
    const to = { ArrowLeft: Math.max(this.at - 1, 0), ArrowRight: Math.min(this.at + 1, last), Home: 0, End: last }[event.key];
    if (to === undefined || last < 0 || event.target !== this.area) return;
    event.preventDefault();
    this.choose(to);
  }

  resized() {
    const width = this.area.clientWidth;
    if (!width) return;
    if (!this.uplot) this.build();
    else if (width !== this.uplot.width) this.uplot.setSize({ width, height: 380 });
  }
}
