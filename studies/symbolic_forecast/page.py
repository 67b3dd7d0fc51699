"""The page and the figure of what `__main__` scored."""

import textwrap
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.plotting.palette import GREEN, model_colours
from neurosym_jax.plotting.style import WIDTH, add_legend, dress, new_figure
from neurosym_jax.symbolic.events import EVENTS
from studies.symbolic_forecast.scores import BINS
from studies.symbolic_forecast.sets import CHOOSING
from studies.weighting.data import LEARNED

PERIOD, STEPS = 0.4, (1, 4, 8)
DRAWN = ("NeuroSyM", "SGAN", "constant velocity", "constant velocity, sampled", "Markov chain")

HEAD = """# Symbols as a forecast

How good are probabilities of what two people will do, from a network's samples, beside the
classical answers? Generated with its figure by

    python -m studies.symbolic_forecast DATA OUT   # {minutes:.0f} minutes on two busy cores, seed 0

where DATA holds ETH/UCY in `eth_ucy`, THÖR's tracks in `thor` and runs of HERMES's corridors, in
which people walk against each other, in `hermes`. Forecast are the QTC_C1 states of ordered pairs
who are within 8 m when they are observed last, 8 + 8 steps of 0.4 s, threshold 0.125 m/s, and the
events of [Symbols](symbols.md#events); 20 samples of the models that ship, none of which was
trained on what it is tested on: HERMES is forecast by those named zara1, which have not seen it.
Numbers are means over test sets, each weighing the same ({sets}); of crowds a window starts at
every n-th step only. What the chain and the smoothing below take from training and validation
scenes, they take of HERMES from {learned}, and from {choosing}.

What comes out:

- Events. In all but HERMES's crossings some sampled forecast of people, of a network or of constant
  velocity, scores best. NeuroSyM beats the Markov chain beyond the interval in approaching,
  passing, following and meeting everywhere, by 0.02 to 0.17 nats a pair. In crossing before it is
  level with the chain on ETH/UCY, and on HERMES it is behind in both crossings (0.05 and 0.01
  nats). Overtaking happens to one to three pairs in a thousand, too few to tell networks from
  constant velocity.
- States. By Brier's score NeuroSyM beats the chain at every horizon but THÖR's first and HERMES's
  last two steps. By the log score, which punishes what was held for nearly impossible, it does so
  from 0.8 to 1.6 s on ETH/UCY, and the chain is level with it later, ahead at some horizons on THÖR
  (0.8, 1.2 and 2.8 s), and on HERMES at all but 0.8 and 1.2 s, by up to 0.44 nats; there sampled
  constant velocity, too, is ahead of the networks from 1.6 s on. The chain has learned from other
  runs of the same experiments, and it spreads its probability over all states that follow one
  another, of which 20 samples know a few: of single symbols NeuroSyM's scores are better than the
  chain's on HERMES, too, but for the sides at the first step.
- A single forecast at constant velocity loses to both in the log score of states, however it is
  smoothed. It has the best Brier score of ETH/UCY's first step, and beats the chain in all events
  of ETH/UCY and THÖR, and on HERMES in all but crossing and overtaking.
- NeuroSyM and SGAN differ little, in either direction.
- Reliability is not perfect: sampled constant velocity says too little of likely events, and
  everybody is too sure of THÖR's symbols. univ and bo-360-160-160 have few windows of many pairs,
  so their part of the intervals is rough.

Scores are the log score in nats, -ln of the probability of what happened, and Brier's; of both,
less is better (`scores.py`). What each forecaster says is smoothed towards how often
things happen in the training scenes, with the weight that is best on the validation scenes, so a
single forecast is judged by the best probabilities that can be made of it, too. The Markov chain is
learned from the training scenes' states and smoothed by the neighbourhood diagram (Hanheide,
Peters, Bellotto 2012; Dondrup, Bellotto, Hanheide 2014); of events it says how frequent they are
after the state observed last. "Diagram only" counts no other transitions than those of the diagram.
Persistence: the state stays, and events happen again. Frequencies look at nobody.

![Scores by horizon, and reliability of events](figures/symbolic_forecast.png)

Left: the log score of states by horizon. Middle: what is said of an event, all events together,
against how often it then happens; on the diagonal a forecaster is calibrated. Right: the same of
the symbols q1 to q4 at all horizons.
"""


def document(found: dict[str, Any]) -> str:
    """The whole page."""
    groups = {name: group for name, group in found.items() if name != "seconds"}
    sets = "; ".join(
        f"{name}: {', '.join(map(_short, group['sets']))}" for name, group in groups.items()
    )
    runs = {"learned": ", ".join(LEARNED), "choosing": " and ".join(CHOOSING)}
    head = HEAD.format(minutes=found["seconds"] / 60, sets=sets, **runs)
    parts = ["\n\n".join(map(_wrapped, head.split("\n\n")))]
    for name, group in groups.items():
        parts += [f"## {name}", _states(group), _symbols(group), _events(group), _compared(group)]
        sizes = group["sets"].items()
        parts.append(
            "Ordered pairs (windows): "
            + "; ".join(
                f"{_short(each)} {size['pairs']} ({size['windows']})" for each, size in sizes
            )
            + "."
        )
    return "\n\n".join(parts) + "\n"


def figure(found: dict[str, Any]) -> Figure:
    """Log score by horizon, and reliability of events and symbols, a row for each group."""
    groups = {name: group for name, group in found.items() if name != "seconds"}
    colours = {**model_colours(DRAWN), "Markov chain": GREEN}
    drawn, panels = new_figure(WIDTH, 2.4 * len(groups), len(groups), 3)
    for row, (name, group) in zip(panels, groups.items()):
        for forecaster in DRAWN:
            colour = colours[forecaster]
            means = group["means"][forecaster]
            steps = [step for step in range(1, 99) if f"log state {step}" in means]
            curve = [means[f"log state {step}"] for step in steps]
            seconds = PERIOD * np.array(steps)
            row[0].plot(seconds, curve, "-o", color=colour, ms=2.5, lw=1.4, label=forecaster)
            reliability = group["reliability"][forecaster]
            _reliability(row[1], [reliability[event] for event in EVENTS], colour)
            _reliability(row[2], [reliability[f"q{i}"] for i in (1, 2, 3, 4)], colour)
        dress(row[0], "horizon [s]", "log score [nats]", f"{name}: states")
        row[0].set(xlim=(0, None), ylim=(0, None))
        for axes, title in ((row[1], "events"), (row[2], "symbols")):
            axes.plot([0, 1], [0, 1], color="#555555", lw=0.8, ls=(0, (4, 3)))
            axes.set(xlim=(0, 1), ylim=(0, 1), aspect="equal")
            dress(axes, "probability said", "share that happened", title)
    add_legend(drawn, panels[0][0])
    return drawn


def _wrapped(paragraph: str) -> str:
    """A paragraph with what was filled in broken into lines."""
    if max(map(len, paragraph.splitlines()), default=0) <= 100:
        return paragraph
    return textwrap.fill(paragraph, 100, break_on_hyphens=False, break_long_words=False)


def _reliability(axes: Axes, parts: list[list[list[float]]], colour: str) -> None:
    said, happened, count = np.sum(parts, axis=0)
    enough = count >= 50
    axes.plot(
        said[enough] / count[enough], happened[enough] / count[enough], "-o", color=colour, ms=2.5,
        lw=1.2,
    )  # fmt: skip
    assert len(count) == BINS


def _short(name: str) -> str:
    """What a recording of THÖR's is called here."""
    return {"CLiFF-LHMP_thor1": "THÖR 1", "CLiFF-LHMP_thor3": "THÖR 3", "THOR-MAGNI": "MAGNI"}.get(
        name.rsplit("_", 2 if "MAGNI" in name else 1)[0], name
    )


def _rows(group: dict[str, Any], metrics: list[str]) -> list[list[str]]:
    """Return the mean scores of each forecaster, the best in bold."""
    means = group["means"]
    best = {m: min(f"{each[m]:.3f}" for each in means.values() if m in each) for m in metrics}
    rows = []
    for name, each in means.items():
        if not any(metric in each for metric in metrics):
            continue
        texts = [f"{each[metric]:.3f}" if metric in each else "-" for metric in metrics]
        texts = [f"**{text}**" if text == best[m] else text for m, text in zip(metrics, texts)]
        rows.append([name, *texts])
    return rows


def _states(group: dict[str, Any]) -> str:
    metrics = [f"{score} state {step}" for score in ("log", "brier") for step in STEPS]
    heads = [f"{s}, {PERIOD * step:.1f} s" for s in ("log", "Brier") for step in STEPS]
    return "States:\n\n" + markdown_table(["", *heads], _rows(group, metrics))


def _symbols(group: dict[str, Any]) -> str:
    metrics = [f"log {symbol} {step}" for symbol in ("q1", "q3") for step in STEPS]
    heads = [f"{s}, {PERIOD * step:.1f} s" for s in ("q1", "q3") for step in STEPS]
    words = "Log scores of symbols; q2 and q4 are those of the exchanged pair, which is there too:"
    return f"{words}\n\n" + markdown_table(["", *heads], _rows(group, metrics))


def _events(group: dict[str, Any]) -> str:
    shares = [size["events"] for size in group["sets"].values()]
    heads = [f"{event} ({100 * np.mean([s[event] for s in shares]):.1f} %)" for event in EVENTS]
    parts = []
    for score, words in (("log", "Log scores of events"), ("brier", "Brier scores of events")):
        metrics = [f"{score} {event} 0" for event in EVENTS]
        table = markdown_table(["", *heads], _rows(group, metrics))
        parts.append(f"{words}, with the share of pairs to whom they happen:\n\n{table}")
    return "\n\n".join(parts)


def _compared(group: dict[str, Any]) -> str:
    metrics = [f"log state {step}" for step in STEPS] + [f"log {event} 0" for event in EVENTS]
    heads = [f"state, {PERIOD * step:.1f} s" for step in STEPS] + list(EVENTS)
    rows = []
    for head, metric in zip(heads, metrics):
        cells = []
        for compared in group["differences"].values():
            mean, low, high = compared[metric]
            text = f"{mean:+.3f} [{low:+.3f}, {high:+.3f}]"
            cells.append(f"**{text}**" if low > 0 or high < 0 else text)
        rows.append([head, *cells])
    words = (
        "Log score of NeuroSyM less that of others, with 95 % of what other test scenes would have "
        "given (blocks of windows drawn with replacement); bold where zero lies outside:"
    )
    return f"{words}\n\n" + markdown_table(["", *group["differences"]], rows)
