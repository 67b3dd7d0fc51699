"""The page of what `__main__` scored."""

from typing import Any

from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.symbolic.events import EVENTS

PERIOD, STEPS = 0.4, (1, 4, 8)
FORECASTERS = (
    *("NeuroSyM", "SGAN", "anchors"),
    *("constant velocity", "constant velocity, sampled", "Markov chain"),
)

HEAD = """# How good are forecast symbols?

**A network's 20 samples predict most events of a pair better than a Markov chain over its states.
The states themselves only `anchors` predicts better at all horizons, and only on ETH/UCY and
THÖR.** It is ahead there by 0.03 to 0.32 nats, and behind at most horizons on HERMES, by up to
0.46. NeuroSyM is ahead of the chain in states on ETH/UCY up to 2.0 s, then behind (by up to 0.11);
on THÖR and HERMES it is behind at six of eight horizons, by up to 0.13 and 0.43. SGAN is no better.

In events, NeuroSyM beats the chain in passing on the left, following and meeting on all three
groups, and in approaching on two, by 0.03 to 0.18 nats a pair. In crossing it is level on ETH/UCY,
ahead on THÖR and behind on HERMES (0.05 and 0.01 nats). Overtaking is too rare to tell.

NeuroSyM and SGAN differ by 0.01 nats at most in events. In states NeuroSyM leads by up to 0.08
nats at 3.2 s. That is one training each, so it says nothing about symbols as weights;
[the study](weighting.md) does. `anchors` is ahead of NeuroSyM in approaching, by 0.01 to 0.10
nats, and in states on ETH/UCY and THÖR, by 0.13 to 0.39.

On HERMES the chain learned from other runs of the same experiments. By the Brier score the networks
lead at nearly all horizons. A single forecast at constant velocity loses to all of them on states.

## Events

Log score of NeuroSyM minus that of the Markov chain, in nats; negative where NeuroSyM is
better. 95 % intervals over test windows; bold where they exclude zero.

{events}

## States

Log score of the QTC_C1 state of a pair, in nats, by horizon; lower is better.

{states}

`symbolic_forecast.csv` beside this page has all scores, Brier's too.

<details markdown="1">
<summary>How this was measured</summary>

    python -m studies.symbolic_forecast DATA OUT   # {minutes:.0f} minutes on two busy cores, seed 0

- Pairs within 8 m at the last observed step; 8 + 8 steps of 0.4 s; threshold 0.125 m/s; 20
  samples.
- {sizes}. Means over test sets, equally weighted. Crowds are sampled at every n-th window.
- No model was trained on its test. HERMES is forecast by the models named zara1.
- Each forecaster is smoothed towards the frequencies of the training scenes, with the weight
  that is best on validation scenes. A single forecast is thus judged by the best probabilities
  that can be made of it.
- The Markov chain is learned from training states and smoothed by the neighbourhood diagram
  (Hanheide, Peters, Bellotto 2012; Dondrup, Bellotto, Hanheide 2014).

</details>
"""


def document(scores: dict[str, Any]) -> str:
    """The page."""
    groups = {name: group for name, group in scores.items() if name != "seconds"}
    sizes = "; ".join(
        f"{name}: {sum(size['pairs'] for size in group['sets'].values()):,} ordered pairs of "
        f"{len(group['sets'])} test sets"
        for name, group in groups.items()
    )
    return HEAD.format(
        events=_events(groups),
        states=_states(groups),
        sizes=sizes,
        minutes=scores["seconds"] / 60,
    )


def table(scores: dict[str, Any]) -> str:
    """All scores as CSV: group, forecaster, score, value."""
    lines = ["group,forecaster,score,what,step,value"]
    for name, group in scores.items():
        if name != "seconds":
            for forecaster, means in group["means"].items():
                for metric, value in means.items():
                    score, target, step = metric.split()
                    lines.append(
                        f'{name},"{forecaster}",{score},{target},{step},{value:.3f}'
                    )
    return "\n".join(lines) + "\n"


def _states(groups: dict[str, Any]) -> str:
    columns = [(name, step) for name in groups for step in STEPS]
    best = {
        column: min(
            f"{means[f'log state {column[1]}']:.2f}"
            for means in _means(groups, column[0])
        )
        for column in columns
    }
    rows = []
    for forecaster in FORECASTERS:
        cells = []
        for name, step in columns:
            text = f"{groups[name]['means'][forecaster][f'log state {step}']:.2f}"
            cells.append(f"**{text}**" if text == best[name, step] else text)
        rows.append([forecaster, *cells])
    return markdown_table(
        ["", *(f"{n}, {PERIOD * s:.1f} s" for n, s in columns)], rows, right=9
    )


def _means(groups: dict[str, Any], name: str) -> list[dict[str, float]]:
    return list(groups[name]["means"].values())


def _events(groups: dict[str, Any]) -> str:
    rows = []
    for event in EVENTS:
        cells = []
        for group in groups.values():
            mean, low, high = group["differences"]["Markov chain"][f"log {event} 0"]
            text = f"{mean:+.2f} ({low:+.2f} to {high:+.2f})"
            cells.append(f"**{text}**" if low > 0 or high < 0 else text)
        rows.append([event.replace("_", " "), *cells])
    return markdown_table(["minus Markov chain", *groups], rows)
