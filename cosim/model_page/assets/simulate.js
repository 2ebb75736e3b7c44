// What the worker of a model's own page computes: one simulation, with inputs that rest.

serve(function* simulate({ settings }, { model }) {
  return yield* model.simulation(settings);
});
