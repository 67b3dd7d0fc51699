"""The words of the page: what is not computed."""

__all__ = ["ANSWER", "TEXT", "TITLES"]

TITLES = {
    "control": "control: a right weighting exists",
    "corridors": "HERMES's corridors",
    "zara2": "ETH/UCY's zara2",
}
"""Titles of the panels."""

ANSWER = """\
**No: on these recordings, weighing neighbours by their QTC states does not make better
forecasts.** In crowded corridors (HERMES), where looking at neighbours lowers the forecast error
of people who interact by 12 %, the weights change it by +0.2 % (−0.7 to +1.2), and on ETH/UCY's
zara2 by +0.6 % (−0.4 to +1.6): less than the 2 % that were declared worth having before the first
run, and not told apart from the same weights given to the wrong people. The same study sees a
right weighting at once: simulated people who go by such symbols are forecast with 61 % less error
by it, and in three of four trainings the network finds it by itself
(`learned`)."""
"""Written by hand from the numbers; check it when they change."""

TEXT = """# Does symbolic weighting help?

{answer}

Does it help, by the rules written down before the first run ([protocol](weighting_protocol.md))?
{verdicts}.

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

The interval is that over seeds, on these test scenes; the wider one is over seeds and test scenes.
"In reach" is the least margin within which equivalence would be shown, without correction, in nine
of ten such studies.

How much alpha varies, and what looking at neighbours is worth. Interacting are those with a
neighbour within 2 m who comes nearer. Of alpha: standard deviation in per cent of the mean,
between one's neighbours at the last observed step / of a pair from step to step. Of a pooling:
joint ADE of the interacting less that without pooling.

{worth}

## What else was measured

`quantised` by the secondary errors, which decide nothing:

{secondary}

The papers' pooling, where a constant is a scale of its own:

{faithful}

Joint ADE of the interacting in metres, mean and standard deviation over seeds (their number):

{errors}

## What would change the answer

- **The other endpoint.** By the energy score nothing differs either, but equivalence within 2 % is
  not shown after correction: a loss of up to 2.4 % on zara2, or a gain of up to 1.6 % on the
  corridors, is possible.
- **Other weights.** `quantised` counts the zeros of a state, and varies by 12 % between one's
  neighbours. `learned` may say anything of the 81 states: with four seeds it is told apart from
  `ones` on neither set, but 2 % can hide there.
- **Symbols of predicted steps.** Here the state observed last weighs a pair for the whole
  forecast. With `pool_every_timestep` every predicted step has its own; that was too dear to be
  trained here.
- **zara2** holds fewer people who interact, and looking at neighbours is worth a third as much
  there; what it says weighs less than what the corridors say.
- **Other budgets.** Runs are short (600 steps) and learn from ten runs of an experiment, or four
  scenes. Symbols might be worth more where there is less to learn from.
- **Smaller effects in the control.** It shows that a large effect is seen, in either direction.
  How small a one can be seen follows from the spread of seeds alone ("in reach").

Tried and left: the papers' pooling brings no gain on the corridors, with weights or without, so no
weights can be told from others in it; and the poolings in the [protocol](weighting_protocol.md).

## How it was made

    NPROC=1 python -m studies.weighting DATA OUT

trains ({steps} steps of {scenes} scenes a run), tests and writes this page; DATA holds HERMES's
runs in `hermes` (`datasets/HERMES` of the public repository crowdbotp/OpenTraj) and ETH/UCY in
`eth_ucy`. All runs together took some 50 minutes of one core. Whoever deletes a run, such as
OUT/runs/corridors_quantised_0.npz, and repeats the command gets the same bits, on the same machine
with the same versions.
"""
