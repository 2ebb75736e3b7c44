"""The WebAssembly flavour: models that run in browsers."""
