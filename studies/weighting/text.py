"""The words of the page: what is not computed."""

__all__ = ["ANSWER", "TEXT", "TITLES"]

TITLES = {
    "control": "control: a right weighting exists",
    "corridors": "HERMES's corridors",
    "zara2": "ETH/UCY's zara2",
}
"""Titles of the panels."""

ANSWER = """\
**For a network that already sees how neighbours move: no. For the papers' own pooling: open.**
We tested this in a preregistered study. The network `encounter` attends to each neighbour's
bearing, relative velocity, and time and distance of closest approach. Weighting its attention
by QTC states changes the joint ADE of people who interact by +0.2 % (−0.7 to +1.2) in crowded
corridors and by +0.6 % (−0.4 to +1.6) on zara2: less than the 2 % that the
[protocol](weighting_protocol.md) had named as worth having. The symbols repeat what these
features say.

The study can see an effect: in its control, where simulated people react to symbols, the right
weighting lowers their error by 61 %, and in three of four trainings the network learns it by
itself (`learned`)."""
"""Written by hand from the numbers; check it when they change."""

TEXT = """# Does symbolic weighting help?

{answer}

By the rules written before the first run: {verdicts}.

!!! warning "Withdrawn on 23 November 2026"
    The arms with SGAN's pooling and with the papers' pooling trained networks that ignored
    their neighbours: all units of their last ReLU had died. So this study cannot say that
    SGAN's pooling is worth nothing, nor anything about weights in the papers' pooling. Earlier
    versions of this page said both. A second study with living poolings will ask again.

![Difference of each arm from the same network without weights](weighting.png)

Joint ADE (best of 20) of people who interact, difference from `ones` in per cent, with 95 %
intervals over seeds. In brackets the number of seeds; the band is ±{margin:g} %.
All runs, the withdrawn ones too, are in `weighting.csv`.

## The comparisons

`quantised` against no weights (`ones`), and against the same weights given to the wrong pairs
(`shuffled`). All p values are corrected together (Holm):

{primary}

## How much there was to gain

People interact if a neighbour within 2 m comes nearer. Alpha's spread is its standard deviation
between a person's neighbours, in per cent of the mean. The last column is the joint ADE of
`encounter` minus that without pooling.

{worth}

## What the answer leaves open

- **The papers' pooling**, see above.
- **The energy score.** No difference was found, but equivalence within 2 % was not shown.
- **Other weights.** `learned` may give any weight to the 81 states. With four seeds it does not
  differ from `ones`, but 2 % could hide there.
- **Symbols of predicted steps.** Here the last observed state weights a pair for the whole
  forecast.
- **Other budgets.** Runs are short ({steps} steps). Symbols might help more with less data.

<details markdown="1">
<summary>How this was measured</summary>

    NPROC=1 python -m studies.weighting DATA OUT

trains ({steps} steps of {scenes} scenes a run), tests, and writes this page in about 50 minutes
of one core. DATA holds HERMES's runs in `hermes` (`datasets/HERMES` of crowdbotp/OpenTraj) and
ETH/UCY in `eth_ucy`. A deleted run, repeated with the same versions, has the same bits. The
[protocol](weighting_protocol.md) has arms, endpoints and tests.

</details>
"""
