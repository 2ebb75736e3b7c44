// The robots of a page: their motions, and how one looks at one time on a canvas.

const ROBOT = DATA.robot;
const MOTIONS = new Map(ROBOT.runs.map((run) => [run.key, run]));

/** Decode the columns of a run, once; each has `rows` values, the first at `start`, then every `step` seconds. */
async function prepared(run) {
  const found = await columnsOf(run.block, run.names.map((name) => ({ name, rows: run.rows })));
  const columns = (run.columns = Object.fromEntries(run.names.map((name, i) => [name, found[i]])));
  if (columns.f1_x && !columns.f3_x) for (const axis of ["x", "y"]) // the forces of the closure balance
    columns[`f3_${axis}`] = columns[`f1_${axis}`].map((f, row) => -f - columns[`f2_${axis}`][row]);
  return run;
}

function endTime(run) {
  return run.start + (run.rows - 1) * run.step;
}

/** Position of a time among the rows: whole part and fraction, held at both ends. */
function place(run, time) {
  const where = Math.min(Math.max((time - run.start) / run.step, 0), run.rows - 1);
  const row = Math.min(Math.floor(where), run.rows - 2);
  return [row, where - row];
}

/** Value of a column at a time, linear between rows; NaN where there is no such column. */
function at(run, name, time) {
  const column = run.columns[name];
  if (!column) return NaN;
  const [row, part] = place(run, time);
  return column[row] + part * (column[row + 1] - column[row]);
}

/** Fit the pixels of a canvas to the screen; returns context, width and height in CSS pixels, cleared. */
function sized(canvas) {
  const ratio = Math.min(devicePixelRatio || 1, 2); // more is not seen and takes time
  const width = canvas.clientWidth;
  const height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return [context, width, height];
}

/** Round numbers that divide a range into about so many parts. */
function ticks(low, high, parts) {
  const rough = (high - low) / Math.max(parts, 1);
  const size = 10 ** Math.floor(Math.log10(rough));
  const step = size * ([1, 2, 5, 10].find((m) => m * size >= rough * 0.999) ?? 10);
  const first = Math.ceil(low / step - 1e-9);
  const last = Math.floor(high / step + 1e-9);
  return Array.from({ length: Math.max(last - first + 1, 0) }, (_, i) => (first + i) * step);
}

/** The largest of 1, 2, 5 times a power of ten that is not above a value. */
function roundBelow(value) {
  const size = 10 ** Math.floor(Math.log10(value));
  return size * [5, 2, 1].find((m) => m * size <= value * 1.001);
}

const CHAINS = [0, 1, 2];

/** Map a view [left, bottom, right, top] in metres to the pixels of a canvas; y points up. */
function projection(view, width, height) {
  const rim = 18; // pixels that labels of the joints need, however small the canvas
  const scale = Math.min((width - 2 * rim) / (view[2] - view[0]), (height - 2 * rim) / (view[3] - view[1]));
  const x0 = width / 2 - (scale * (view[0] + view[2])) / 2;
  const y0 = height / 2 + (scale * (view[1] + view[3])) / 2;
  return { scale, x: (x) => x0 + scale * x, y: (y) => y0 - scale * y };
}

/** Joints of the robot (m) at a time: bases, elbows, ends of the chains and end effector. */
function pose(run, time) {
  const { l, x_A, y_A } = run.robot;
  const value = (name) => at(run, name, time);
  const elbow = CHAINS.map((i) => {
    const a = value(`a${i + 1}`);
    return [x_A[i] + l * Math.cos(a), y_A[i] + l * Math.sin(a)];
  });
  const end = CHAINS.map((i) => {
    const b = value(`b${i + 1}`);
    return [elbow[i][0] + l * Math.cos(b), elbow[i][1] + l * Math.sin(b)];
  });
  return { base: CHAINS.map((i) => [x_A[i], y_A[i]]), elbow, end, E: [value("E_x"), value("E_y")] };
}

/** Draw one robot. `options`: view, trail, forces, torques (all of them yes or no but the view). */
function drawRobot(canvas, run, time, options) {
  const [c, width, height] = sized(canvas);
  if (!width) return;
  const view = ROBOT.views[options.view];
  const to = projection(view, width, height);
  const chainColours = [theme.get("chain-1"), theme.get("chain-2"), theme.get("chain-3")];
  c.lineCap = "round";
  c.lineJoin = "round";
  drawGrid(c, to, width, height, options.view === "path" ? 0.02 : 0.1);
  drawPaths(c, to, run, time, options);
  const joints = pose(run, time);
  const size = options.view === "path" ? 1.5 : 1;
  drawLinks(c, to, joints, chainColours, Math.max(width / 480, 0.72) * size, options.torques);
  if (options.torques) drawTorques(c, to, run, time, joints, width);
  if (options.forces) drawForces(c, to, run, time, joints, chainColours, width);
  drawTarget(c, to, run, time, joints, Math.max(width / 480, 0.72));
  drawScales(c, to, width, height, options);
}

function drawGrid(c, to, width, height, spacing) {
  c.strokeStyle = theme.get("grid");
  c.lineWidth = 1;
  c.beginPath();
  const left = -to.x(0) / to.scale;
  const bottom = (to.y(0) - height) / to.scale;
  for (let i = Math.ceil(left / spacing); to.x(i * spacing) < width; i++) {
    c.moveTo(Math.round(to.x(i * spacing)) + 0.5, 0);
    c.lineTo(Math.round(to.x(i * spacing)) + 0.5, height);
  }
  for (let i = Math.ceil(bottom / spacing); to.y(i * spacing) > 0; i++) {
    c.moveTo(0, Math.round(to.y(i * spacing)) + 0.5);
    c.lineTo(width, Math.round(to.y(i * spacing)) + 0.5);
  }
  c.stroke();
}

/** A polyline through every so many-th row, from first to last, of two columns. */
function trace(c, to, xs, ys, first, last, every = 1) {
  c.beginPath();
  for (let row = first; row < last; row += every) c.lineTo(to.x(xs[row]), to.y(ys[row]));
  if (last >= first) c.lineTo(to.x(xs[last]), to.y(ys[last]));
}

function drawPaths(c, to, run, time, options) {
  const { E_x, E_y, d_x, d_y } = run.columns;
  if (d_x) {
    // a wide pale band, on which the actual path is easy to compare
    c.strokeStyle = theme.get("desired-band");
    c.lineWidth = options.view === "path" ? 6 : Math.max(3, to.scale * 0.006);
    trace(c, to, d_x, d_y, 0, run.rows - 1, 3); // long lines take time, and fewer corners are not seen
    c.stroke();
  }
  if (!options.trail) return;
  const [row] = place(run, time);
  c.strokeStyle = theme.get("actual");
  c.globalAlpha = 0.4;
  c.lineWidth = 1.3;
  trace(c, to, E_x, E_y, 0, row, 3);
  c.stroke();
  // the last two seconds in eight strokes, each stronger than the one before
  const length = Math.round(2 / run.step / 8);
  c.lineCap = "butt"; // round ends of pale strokes show where they overlap
  for (let i = 7; i >= 0; i--) {
    const last = row - i * length;
    if (last < 1) continue;
    c.globalAlpha = 1 - i / 9;
    c.lineWidth = 3.5 - i * 0.25;
    trace(c, to, E_x, E_y, Math.max(last - length, 0), last);
    if (i === 0) c.lineTo(to.x(at(run, "E_x", time)), to.y(at(run, "E_y", time)));
    c.stroke();
  }
  c.lineCap = "round";
  c.globalAlpha = 1;
}

function drawLinks(c, to, joints, colours, size, torques) {
  const line = (from, end, width, colour) => {
    c.strokeStyle = colour;
    c.lineWidth = width;
    c.beginPath();
    c.moveTo(to.x(from[0]), to.y(from[1]));
    c.lineTo(to.x(end[0]), to.y(end[1]));
    c.stroke();
  };
  const disc = (at, radius, fill, stroke) => {
    c.beginPath();
    c.arc(to.x(at[0]), to.y(at[1]), radius, 0, 2 * Math.PI);
    c.fillStyle = fill;
    c.fill();
    c.strokeStyle = stroke;
    c.lineWidth = 2 * size;
    c.stroke();
  };
  const paper = theme.get("stage");
  for (const i of CHAINS) {
    line(joints.elbow[i], joints.end[i], 8 * size, paper); // a rim that sets crossing links apart
    line(joints.elbow[i], joints.end[i], 5 * size, colours[i]);
  }
  for (const i of CHAINS) {
    line(joints.base[i], joints.elbow[i], 13 * size, paper);
    line(joints.base[i], joints.elbow[i], 10 * size, colours[i]);
    disc(joints.elbow[i], 5.5 * size, paper, colours[i]);
    const [x, y] = [to.x(joints.base[i][0]), to.y(joints.base[i][1])];
    c.fillStyle = theme.get("ink");
    c.beginPath();
    c.roundRect(x - 10 * size, y - 10 * size, 20 * size, 20 * size, 4 * size);
    c.fill();
    disc(joints.base[i], 4 * size, paper, colours[i]);
    c.font = `600 ${Math.round(11 + 2 * size)}px ${theme.get("font")}`;
    c.textAlign = "center";
    c.textBaseline = "middle";
    c.fillStyle = theme.get("ink");
    const away = joints.elbow[i][1] > joints.base[i][1] ? 1 : -1; // the label is where the link is not
    c.fillText(`A${"₁₂₃"[i]}`, x, y + away * (torques ? 33 : 23) * size);
  }
}

function arrow(c, x, y, dx, dy, colour, width) {
  const length = Math.hypot(dx, dy);
  if (!(length >= 1.5)) return; // nor if it is no number
  const head = Math.min(4.2 * width, 0.6 * length);
  const [ux, uy] = [dx / length, dy / length];
  const [tx, ty] = [x + dx, y + dy];
  const wing = (side) => [tx - head * ux + side * 0.5 * head * uy, ty - head * uy - side * 0.5 * head * ux];
  for (const [colour_, extra] of [[theme.get("stage"), 3], [colour, 0]]) {
    c.strokeStyle = c.fillStyle = colour_;
    c.lineWidth = width + extra;
    c.beginPath();
    c.moveTo(x, y);
    c.lineTo(tx - 0.8 * head * ux, ty - 0.8 * head * uy);
    c.stroke();
    c.lineWidth = extra || 1;
    c.beginPath();
    c.moveTo(tx, ty);
    c.lineTo(...wing(1));
    c.lineTo(...wing(-1));
    c.closePath();
    c.fill();
    c.stroke();
  }
}

/** Length of an arrow: the largest force of usual size takes a fifth of the width. */
function forceScale(width) {
  return (0.2 * width) / ROBOT.force;
}

function drawForces(c, to, run, time, joints, colours, width) {
  const scale = forceScale(width);
  const [x, y] = [to.x(joints.E[0]), to.y(joints.E[1])];
  for (const i of CHAINS) {
    const f = [at(run, `f${i + 1}_x`, time), at(run, `f${i + 1}_y`, time)];
    arrow(c, x, y, scale * f[0], -scale * f[1], colours[i], Math.max(2.5, width / 160));
  }
}

/** Torque of a motor as an arc around its base, turning the way it does: three quarters of a turn are the usual most. */
function drawTorques(c, to, run, time, joints, width) {
  for (const i of CHAINS) {
    const share = at(run, `tau${i + 1}`, time) / ROBOT.torque;
    const angle = Math.max(-1, Math.min(1, share)) * 1.5 * Math.PI;
    if (Math.abs(angle) < 0.05) continue;
    const [x, y] = [to.x(joints.base[i][0]), to.y(joints.base[i][1])];
    const radius = width * 0.048;
    const start = Math.PI / 2;
    c.strokeStyle = c.fillStyle = theme.get("torque");
    c.lineWidth = Math.max(2, width / 190);
    c.beginPath();
    c.arc(x, y, radius, -start, -(start + angle), angle > 0);
    c.stroke();
    const tip = start + angle;
    const turn = Math.sign(angle);
    const head = Math.max(6, width / 60);
    const [px, py] = [x + radius * Math.cos(tip), y - radius * Math.sin(tip)];
    const [ux, uy] = [-Math.sin(tip) * turn, -Math.cos(tip) * turn];
    c.beginPath();
    c.moveTo(px + head * ux, py + head * uy);
    c.lineTo(px + 0.5 * head * uy, py - 0.5 * head * ux);
    c.lineTo(px - 0.5 * head * uy, py + 0.5 * head * ux);
    c.fill();
  }
}

function drawTarget(c, to, run, time, joints, size) {
  const ring = (x, y, radius, fill, stroke) => {
    c.beginPath();
    c.arc(to.x(x), to.y(y), radius, 0, 2 * Math.PI);
    c.lineWidth = 2;
    if (fill) {
      c.fillStyle = fill;
      c.fill();
    }
    c.strokeStyle = stroke;
    c.stroke();
  };
  ring(...joints.E, 6 * size, theme.get("actual"), theme.get("stage"));
  const desired = [at(run, "d_x", time), at(run, "d_y", time)];
  if (Number.isFinite(desired[0])) ring(...desired, 8.5 * size, null, theme.get("desired"));
}

/** Bars that say how long a length, and how large a force, is. */
function drawScales(c, to, width, height, options) {
  c.font = `12px ${theme.get("font")}`;
  c.textBaseline = "middle";
  c.textAlign = "left";
  const bar = (pixels, text, y, colour) => {
    c.strokeStyle = c.fillStyle = colour;
    c.lineWidth = 2;
    c.beginPath();
    c.moveTo(12, y - 4);
    c.lineTo(12, y + 4);
    c.moveTo(12, y);
    c.lineTo(12 + pixels, y);
    c.moveTo(12 + pixels, y - 4);
    c.lineTo(12 + pixels, y + 4);
    c.stroke();
    c.fillStyle = theme.get("ink");
    c.fillText(text, 20 + pixels, y);
  };
  const length = options.view === "path" ? 0.02 : 0.1;
  bar(length * to.scale, `${1000 * length} mm`, height - 14, theme.get("muted"));
  if (options.forces) {
    const force = roundBelow(0.7 * ROBOT.force);
    bar(force * forceScale(width), `${shown(force, 1)} N`, height - 34, theme.get("muted"));
  }
  if (options.torques) {
    c.fillStyle = theme.get("muted");
    c.fillText(`¾ turn: ${shown(ROBOT.torque, 2)} N m`, 12, height - (options.forces ? 54 : 34));
  }
}
