"""Time that this process has spent compiling, which a running robot must not."""

import jax

_seconds = 0.0


def _count(event, seconds, **_):
    global _seconds
    if event.startswith("/jax/core/compile/"):
        _seconds += seconds


jax.monitoring.register_event_duration_secs_listener(_count)


def compile_seconds():
    """Seconds of tracing and compiling since this module was imported."""
    return _seconds
