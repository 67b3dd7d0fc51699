"""What an evaluation's numbers mean, in a sentence computed from them."""

from collections.abc import Sequence

from neurosym_jax.evaluation.summary import Line

__all__ = ["conclusion"]


def conclusion(lines: Sequence[Line], period: float, *, simulated: bool = False) -> str:
    """How far off each model is on average, and who is ahead as far as the scenes can tell.

    Args:
        lines: of all models on the same test sets, of one horizon.
        period: seconds between steps.
        simulated: whether the people are.
    """
    errors: dict[str, list[float]] = {}
    ahead: dict[str, list[str]] = {}
    tests = list(dict.fromkeys(line.test_set.dataset for line in lines))
    for line in lines:
        ade = line.values["joint_ade"]
        errors.setdefault(line.model, []).append(ade.mean or 0.0)
        if ade.best:
            ahead.setdefault(line.model, []).append(line.test_set.dataset)
    means = {name: sum(of) / len(of) for name, of in errors.items()}
    samples = {line.model: line.rows[0]["samples"] for line in lines}
    drawn = [name for name in sorted(means, key=means.__getitem__) if samples[name] > 1]
    parts = []
    if drawn:
        of = _and([f"{means[name]:.2f} m with {name}" for name in drawn])
        seconds = f"{lines[0].test_set.pred_len * period:.1f} s"
        parts.append(
            f"the best of {samples[drawn[0]]} forecasts of the next {seconds} is off by {of}"
        )
    single = [
        f"{name}'s only one by {of:.2f} m" for name, of in means.items() if samples[name] == 1
    ]
    if single:
        parts.append(_and(single))
    told = [f"{name} is ahead of all others on {_and(of)}" for name, of in ahead.items()]
    if nobody := [name for name in tests if not any(name in of for of in ahead.values())]:
        told.append(f"nobody on {_and(nobody)}" if told else "nobody is ahead of all others")
    ends = "; simulated people say nothing of real ones" if simulated else ""
    return f"On average, {', '.join(parts)}; by 95 % intervals {_and(told)}{ends}."


def _and(parts: Sequence[str]) -> str:
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)
