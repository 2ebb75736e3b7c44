// What the worker of the live page computes: what acts on the robot, then the closed loop under it.

const ACTING = ["tau_d[1]", "tau_d[2]", "tau_d[3]", "dm", "dm_rate"];
const COLUMNS = {
  a1: "plant.theta_a[1]", a2: "plant.theta_a[2]", a3: "plant.theta_a[3]",
  b1: "plant.theta_b[1]", b2: "plant.theta_b[2]", b3: "plant.theta_b[3]",
  E_x: "plant.x_E", E_y: "plant.y_E", d_x: "trajectory.x_ref", d_y: "trajectory.y_ref",
  tau1: "controller.tau_a[1]", tau2: "controller.tau_a[2]", tau3: "controller.tau_a[3]",
  psi1: "controller.psi[1]", psi2: "controller.psi[2]",
}; // prettier-ignore
let acted = { key: "", values: {} };

serve(function* live({ start, acts, stopTime, step, tolerance, steadyAfter }, { loop, acting }) {
  const key = JSON.stringify([acts, stopTime, step]);
  if (acted.key !== key) {
    const run = acting.simulate({ start: acts, startTime: 0, stopTime, stepSize: step, record: ACTING });
    if (run.error) throw new Error(run.error);
    acted = { key, values: run.values };
  }
  const inputs = Object.fromEntries(ACTING.map((name) => [`plant.${name}`, acted.values[name]]));
  const run = yield* loop.simulation({
    start, inputs, startTime: 0, stopTime, stepSize: step, tolerance, linear: true, record: Object.values(COLUMNS),
  }); // prettier-ignore
  const columns = Object.fromEntries(Object.entries(COLUMNS).map(([name, variable]) => [name, run.values[variable]]));
  return { ...measured(columns, step, steadyAfter), columns, error: run.error, rows: run.time.length, time: run.time };
});

/** Distance from the desired position (mm), and what is read off: rms and peak of it after a time, rms of the torques. */
function measured(columns, step, steadyAfter) {
  const { E_x, E_y, d_x, d_y, tau1, tau2, tau3 } = columns;
  columns.error = E_x.map((x, i) => 1e3 * Math.hypot(x - d_x[i], E_y[i] - d_y[i]));
  const steady = columns.error.subarray(Math.round(steadyAfter / step));
  const square = (sum, value) => sum + value * value;
  const efforts = [tau1, tau2, tau3].reduce((sum, tau) => sum + tau.reduce(square, 0), 0);
  return {
    rms: steady.length ? Math.sqrt(steady.reduce(square, 0) / steady.length) : NaN,
    peak: steady.length ? steady.reduce((most, value) => Math.max(most, value), 0) : NaN,
    effort: Math.sqrt(efforts / (3 * tau1.length)),
  };
}
