"""The words of the page: what is not computed."""

__all__ = ["ANSWER", "TEXT", "TITLES"]

TITLES = {
    "control": "control: a right weighting exists",
    "corridors": "HERMES's corridors",
    "zara2": "ETH/UCY's zara2",
}
"""Of the panels."""

ANSWER = ""
"""Three sentences, written by whoever read the numbers."""

TEXT = """# Does symbolic weighting help?

{answer}

By the rules written down before the first run ([protocol](weighting_protocol.md)): {verdicts}.

![Difference of each arm from the same network without weights](weighting.png)

Joint ADE (best of 20) of the people who interact, less that of `ones`, in per cent, with the
interval of 95 % over seeds; the number of seeds is in brackets, the band is ±{margin:g} %. All
runs are in `weighting.csv`.

## The comparisons

Can the study see a weighting that is right? Simulated people who give way by their symbols:

{control}

`quantised` beside no weights, and beside the same weights with the wrong pairs; p values are
corrected for all of these comparisons (Holm):

{primary}

"Other scenes, too" is the interval over seeds and test scenes. "In reach" is the least margin
within which equivalence would be shown, without correction, in nine of ten such studies.

How much alpha varies, and what looking at neighbours is worth. Interacting are those with a
neighbour within 2 m who comes nearer. Of alpha: standard deviation in per cent of the mean, between
one's neighbours at the last observed step / of a pair from step to step. Of a pooling: joint ADE
of the interacting less that without pooling.

{worth}

## What else was measured

`quantised` by the secondary errors, which decide nothing:

{secondary}

The papers' pooling, where a constant is a scale of its own:

{faithful}

Joint ADE of the interacting in metres, mean and standard deviation over seeds (their number):

{errors}

## How it was made

    NPROC=1 python -m studies.weighting DATA OUT

trains ({steps} steps of {scenes} scenes a run), tests and writes this page; DATA holds HERMES's
runs in `hermes` and ETH/UCY in `eth_ucy`. Which poolings were tried before stands in the
[protocol](weighting_protocol.md).
"""
