// The map of the performance index J over alpha and beta: its optimum, the present gains, and gains by a click.

class IndexMap {
  /** `data`: powers and rows of coefficients; `take(alpha, beta)` is called with the gains of a click. */
  constructor(canvas, data, take) {
    this.canvas = canvas;
    this.data = data;
    this.range = { alpha: [0.2, 5], beta: [0.4, 8] }; // logarithmic
    this.gains = { alpha: 1, beta: 1 };
    this.choose(Object.keys(data.rows)[0]);
    canvas.addEventListener("click", (event) => {
      const box = canvas.getBoundingClientRect();
      const alpha = this.gain("alpha", (event.clientX - box.left - this.inset.left) / this.width);
      const beta = this.gain("beta", 1 - (event.clientY - box.top - this.inset.top) / this.height);
      take(alpha, beta);
    });
    keepPainted(canvas, () => this.paint());
  }

  choose(row) {
    this.row = this.data.rows[row];
    this.paint();
  }

  show(alpha, beta) {
    this.gains = { alpha, beta };
    this.paint();
  }

  value(alpha, beta) {
    const { powers } = this.data;
    return this.row.coefficients.reduce((J, c, i) => J + c * alpha ** powers.alpha[i] * beta ** powers.beta[i], 0);
  }

  gain(which, share) {
    const [low, high] = this.range[which];
    return Number((low * (high / low) ** Math.min(Math.max(share, 0), 1)).toPrecision(3));
  }

  share(which, gain) {
    const [low, high] = this.range[which];
    return Math.log(gain / low) / Math.log(high / low);
  }

  paint() {
    const [c, width, height] = sized(this.canvas);
    if (!width || !this.row) return;
    this.inset = { left: 38, right: 8, top: 8, bottom: 34 };
    this.width = width - this.inset.left - this.inset.right;
    this.height = height - this.inset.top - this.inset.bottom;
    this.paintValues(c);
    this.paintAxes(c);
    this.mark(c, this.row.alpha, this.row.beta, true);
    this.mark(c, this.gains.alpha, this.gains.beta, false);
  }

  /** Put the bands on the canvas; they are painted when the row, the size or the colours have changed. */
  paintValues(c) {
    const { width, height } = this.canvas;
    const key = [this.row.alpha, this.row.beta, width, height, theme.get("accent")].join();
    if (this.painted?.key !== key) {
      const bands = Object.assign(document.createElement("canvas"), { width, height });
      const context = bands.getContext("2d");
      context.setTransform(c.getTransform());
      this.paintBands(context);
      this.painted = { key, bands };
    }
    c.save();
    c.resetTransform();
    c.drawImage(this.painted.bands, 0, 0);
    c.restore();
  }

  /** Bands: from one to the next the distance of J from its minimum doubles. */
  paintBands(c) {
    const size = 2; // pixels of a cell
    const [columns, rows] = [Math.ceil(this.width / size), Math.ceil(this.height / size)];
    const { powers } = this.data;
    const { coefficients } = this.row;
    const of = (which, share) => powers[which].map((power) => this.exact(which, share) ** power);
    const across = Array.from({ length: columns }, (_, i) => of("alpha", (i + 0.5) / columns));
    c.fillStyle = theme.get("accent");
    for (let j = 0; j < rows; j++) {
      const beta = of("beta", 1 - (j + 0.5) / rows);
      const factors = coefficients.map((coefficient, i) => coefficient * beta[i]);
      for (let i = 0; i < columns; ) {
        const band = this.band(factors, across[i]);
        let end = i + 1;
        while (end < columns && this.band(factors, across[end]) === band) end++;
        c.globalAlpha = Math.min(0.04 + 0.075 * band, 0.85);
        c.fillRect(this.inset.left + i * size, this.inset.top + j * size, (end - i) * size, size);
        i = end;
      }
    }
    c.globalAlpha = 1;
  }

  exact(which, share) {
    const [low, high] = this.range[which];
    return low * (high / low) ** share;
  }

  band(factors, alphas) {
    let J = 0;
    for (let k = 0; k < factors.length; k++) J += factors[k] * alphas[k];
    return Math.max(0, Math.floor(Math.log2(Math.max(J / this.row.J - 1, 1e-9)) + 8));
  }

  paintAxes(c) {
    const { left, top } = this.inset;
    const bottom = top + this.height;
    c.strokeStyle = theme.get("line");
    c.strokeRect(left, top, this.width, this.height);
    c.fillStyle = theme.get("muted");
    c.font = `12px ${theme.get("font")}`;
    c.textBaseline = "top";
    c.textAlign = "center";
    for (const gain of [0.2, 0.5, 1, 2, 5]) c.fillText(gain, left + this.share("alpha", gain) * this.width, bottom + 4);
    c.fillText("α", left + this.width / 2, bottom + 18);
    c.textBaseline = "middle";
    c.textAlign = "right";
    for (const gain of [0.5, 1, 2, 5]) c.fillText(gain, left - 5, bottom - this.share("beta", gain) * this.height);
    c.fillText("β", left - 22, top + this.height / 2);
  }

  /** A cross at the optimum, a ring at the present gains; one that is outside stands at the edge, pale. */
  mark(c, alpha, beta, isOptimum) {
    const shares = [this.share("alpha", Math.max(alpha, 1e-9)), this.share("beta", Math.max(beta, 1e-9))];
    const inside = shares.every((share) => share >= 0 && share <= 1);
    const [u, v] = shares.map((share) => Math.min(Math.max(share, 0), 1));
    const [x, y] = [this.inset.left + u * this.width, this.inset.top + (1 - v) * this.height];
    c.globalAlpha = inside ? 1 : 0.5;
    for (const [colour, width] of [[theme.get("card"), 5], [theme.get("ink"), 2]]) {
      c.strokeStyle = colour;
      c.lineWidth = width;
      c.beginPath();
      if (isOptimum) {
        c.moveTo(x - 6, y);
        c.lineTo(x + 6, y);
        c.moveTo(x, y - 6);
        c.lineTo(x, y + 6);
      } else c.arc(x, y, 9, 0, 2 * Math.PI);
      c.stroke();
    }
    c.globalAlpha = 1;
  }
}
