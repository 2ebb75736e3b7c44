"""A clock for tests: time passes when somebody sleeps, or when a test says so."""


class Clock:
    """In place of the module `time`."""

    def __init__(self) -> None:
        self.now = 100.0  # s

    def perf_counter(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += 0.75 * seconds  # sleeping may end early
