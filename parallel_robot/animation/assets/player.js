// The animation: one or two robots on one clock, with play, pause, scrub, speed and choice of the runs.

function startPlayer(root) {
  const find = (selector) => root.querySelector(selector);
  const stages = [...root.querySelectorAll(".stage")].map((element) => ({
    element,
    canvas: element.querySelector("canvas"),
    select: element.querySelector("select"),
    readout: element.querySelector(".readout"),
  }));
  const slider = find("input[type=range]");
  const timeline = find(".timeline canvas");
  const playButton = find(".play");
  const speed = find(".speed");
  const spoken = find("[role=status]");
  const state = { time: 0, playing: false, frames: 0, last: null, request: 0 };

  const runOf = (stage) => MOTIONS.get(stage.select.value);
  const shownStages = () => stages.filter((stage) => !stage.element.hidden);
  const end = () => Math.max(...shownStages().map((stage) => endTime(runOf(stage))));
  const options = () => ({
    view: find("input[name=view]:checked").value,
    trail: find(".trail").checked,
    forces: find(".forces").checked,
    torques: find(".torques").checked,
  });

  function describe(stage) {
    const run = runOf(stage);
    const error = at(run, "error", state.time);
    return Number.isFinite(error) ? `${run.label}: ${shown(1e3 * error)} mm off the desired position` : run.label;
  }

  function draw() {
    const chosen = options();
    for (const stage of shownStages()) {
      const run = runOf(stage);
      drawRobot(stage.canvas, run, state.time, chosen);
      const force = Math.max(
        ...CHAINS.map((i) =>
          Math.hypot(at(run, `f${i + 1}_x`, state.time), at(run, `f${i + 1}_y`, state.time)),
        ),
      );
      const torque = Math.max(...CHAINS.map((i) => Math.abs(at(run, `tau${i + 1}`, state.time))));
      const error = 1e3 * at(run, "error", state.time);
      const values = [error, force, torque].map((v) => (Number.isFinite(v) ? v.toFixed(v < 9.995 ? 2 : 1) : "–"));
      stage.readout.querySelectorAll("b").forEach((element, i) => (element.textContent = values[i]));
    }
    slider.value = state.time;
    find(".now").textContent = state.time.toFixed(2);
    root.dataset.time = state.time.toFixed(3);
    root.dataset.frames = ++state.frames;
  }

  /** Say the state where it stands still: for those who do not see the picture. */
  function say() {
    slider.setAttribute("aria-valuetext", `${state.time.toFixed(2)} of ${end().toFixed(0)} seconds`);
    spoken.textContent = `${state.playing ? "Playing" : "Paused"} at ${state.time.toFixed(2)} s. ${shownStages()
      .map(describe)
      .join(". ")}.`;
  }

  function frame(now) {
    if (!state.playing) return;
    // a page that was hidden must not jump ahead
    const passed = state.last === null ? 0 : Math.min((now - state.last) / 1e3, 0.5);
    state.last = now;
    state.time = Math.min(state.time + passed * Number(speed.value), end());
    if (state.time >= end()) play(false);
    draw();
    if (state.playing) state.request = requestAnimationFrame(frame);
  }

  function play(on) {
    if (on === state.playing) return;
    if (on && state.time >= end()) state.time = 0;
    state.playing = on;
    state.last = null;
    root.dataset.state = on ? "playing" : "paused";
    playButton.querySelector(".word").textContent = on ? "Pause" : "Play";
    playButton.querySelector("path").setAttribute("d", on ? "M4 2h3v12H4zM9 2h3v12H9z" : "M4 2l10 6-10 6z");
    say();
    // a frame that was asked for before a pause would draw on, beside those of the next start
    if (on) state.request = requestAnimationFrame(frame);
    else cancelAnimationFrame(state.request);
  }

  function seek(time) {
    state.time = Math.min(Math.max(time, 0), end());
    draw();
    if (!state.playing) say();
  }

  /** The error of the shown runs over time, under the slider. */
  function drawTimeline() {
    const [c, width, height] = sized(timeline);
    const stop = end();
    const pad = 7; // half the width of the slider's thumb
    const x = (time) => pad + (time / stop) * (width - 2 * pad);
    const errors = shownStages().map((stage) => runOf(stage).columns.error).filter(Boolean);
    // the run-in is larger than all that follows: it may leave the picture
    const top = 1.4 * Math.max(...errors.map((e) => Math.max(...e.subarray(Math.round(e.length * 0.1)))), 1e-6);
    c.font = `11px ${theme.get("font")}`;
    c.textBaseline = "top";
    c.strokeStyle = theme.get("grid");
    c.fillStyle = theme.get("muted");
    for (const time of ticks(0, stop, width / 60)) {
      c.beginPath();
      c.moveTo(x(time), 0);
      c.lineTo(x(time), height - 15);
      c.stroke();
      c.textAlign = time === 0 ? "left" : time > stop - 1e-6 ? "right" : "center";
      c.fillText(`${shown(time, 2).replace(/\.0$/, "")}${time === 0 ? " s" : ""}`, x(time), height - 12);
    }
    shownStages().forEach((stage, i) => {
      const run = runOf(stage);
      const error = run.columns.error;
      if (!error) return;
      c.strokeStyle = theme.get(i ? "second" : "actual");
      c.lineWidth = 1.5;
      c.setLineDash(i ? [4, 3] : []);
      c.beginPath();
      error.forEach((value, row) =>
        c.lineTo(x(run.start + row * run.step), Math.max((1 - value / top) * (height - 16), -4)),
      );
      c.stroke();
      c.setLineDash([]);
    });
    c.textAlign = "right";
    if (errors.length) c.fillText("distance from the desired position", width - pad, 0);
    const onset = shownStages().map((stage) => runOf(stage).onset).find((time) => time !== null);
    if (onset === undefined) return;
    c.strokeStyle = theme.get("muted");
    c.setLineDash([2, 3]);
    c.beginPath();
    c.moveTo(x(onset), 0);
    c.lineTo(x(onset), height - 15);
    c.stroke();
    c.setLineDash([]);
    c.textAlign = "left";
    if (width > 500) c.fillText("disturbance starts", x(onset) + 4, 0);
  }

  function choose() {
    slider.max = end();
    stages.forEach((stage, i) => (root.dataset[i ? "right" : "left"] = stage.element.hidden ? "" : stage.select.value));
    for (const stage of stages) {
      stage.canvas.setAttribute("aria-label", `Robot under ${runOf(stage).label}; three chains, desired and actual path`);
    }
    find(".legend-second").hidden = stages[1].element.hidden;
    drawTimeline();
    seek(state.time);
  }

  playButton.addEventListener("click", () => play(!state.playing));
  find(".restart").addEventListener("click", () => seek(0));
  slider.addEventListener("input", () => seek(Number(slider.value)));
  speed.addEventListener("change", () => (root.dataset.speed = speed.value));
  for (const stage of stages) stage.select.addEventListener("change", choose);
  find(".two").addEventListener("change", (event) => {
    stages[1].element.hidden = !event.target.checked;
    root.classList.toggle("single", !event.target.checked);
    choose();
  });
  for (const input of root.querySelectorAll("input[type=checkbox]:not(.two), input[type=radio]")) {
    input.addEventListener("change", draw);
  }
  root.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const own = event.target.matches("select, button, input[type=checkbox], input[type=radio]");
    const step = event.shiftKey ? 1 : 0.1;
    const jumps = { ArrowLeft: -step, ArrowRight: step, Home: -Infinity, End: Infinity };
    if (event.key === " " && !own) play(!state.playing);
    else if (event.key in jumps && !event.target.matches("select, input[type=radio]")) seek(state.time + jumps[event.key]);
    else return;
    event.preventDefault();
  });

  root.dataset.speed = speed.value;
  root.dataset.state = "paused";
  keepPainted(stages[0].canvas, draw);
  keepPainted(stages[1].canvas, draw);
  keepPainted(timeline, drawTimeline);
  choose();
  // it starts by itself when it comes into view, unless the reader prefers stillness or was there before
  if (!matchMedia("(prefers-reduced-motion: reduce)").matches) {
    const watcher = new IntersectionObserver(
      (entries) => {
        if (!entries.some((entry) => entry.isIntersecting)) return;
        watcher.disconnect();
        play(true);
      },
      { threshold: 0.6 },
    );
    watcher.observe(stages[0].canvas);
    for (const kind of ["pointerdown", "keydown"]) root.addEventListener(kind, () => watcher.disconnect());
  }
}

Promise.all(ROBOT.runs.map(prepared)).then(() => document.querySelectorAll(".player").forEach(startPlayer));
