// Pictures of compared signals: curves and band, and below where in the band the result is; drawn when they come into view.

async function drawPicture(figure, { name, unit, limit, columns, block }) {
  const found = await columnsOf(block, columns);
  const [lower, upper, reference, result, place, outside] = Array.from({ length: columns.length / 2 }, (_, k) => ({
    times: found[2 * k],
    values: found[2 * k + 1],
  }));
  const ends = [reference, result].flatMap(({ times }) => (times.length ? [times[0], times.at(-1)] : []));
  const view = new TimeView(Math.min(...ends), Math.max(...ends));
  new Plot(figure.querySelector(".curves"), view, {
    title: name,
    unit,
    height: 190,
    bands: [{ lower: 0, upper: 1 }],
    series: [
      { ...lower, label: "lower bound", colour: 2, dash: [] },
      { ...upper, label: "upper bound", colour: 2, dash: [] },
      { ...reference, label: "reference", colour: 4, dash: [] },
      { ...result, label: "result", colour: 1, dash: [6, 3] },
    ],
  });
  const bounds = [-1, 1].map((v) => ({ times: [view.all.from, view.all.to], values: [v, v] }));
  new Plot(figure.querySelector(".place"), view, {
    title: `Place of ${name} in its band`,
    unit: "",
    height: 110,
    range: [-limit, limit],
    bands: [{ lower: 0, upper: 1 }],
    say: false,
    series: [
      { ...bounds[0], label: "lower bound", colour: 2, dash: [] },
      { ...bounds[1], label: "upper bound", colour: 2, dash: [] },
      { ...place, label: "result", colour: 1, dash: [] },
      { ...outside, label: "outside", colour: 7, dots: true },
    ],
  });
  figure.dataset.drawn = "yes";
}

const inView = new IntersectionObserver(
  (entries) => {
    for (const { isIntersecting, target } of entries) {
      if (!isIntersecting) continue;
      inView.unobserve(target);
      drawPicture(target, DATA.pictures[target.dataset.picture]);
    }
  },
  { rootMargin: "200px" },
);
for (const figure of document.querySelectorAll("figure[data-picture]")) inView.observe(figure);
