"""The words of the page: what is not computed."""

__all__ = ["ANSWER", "TEXT"]

ANSWER = """\
**The papers' weights lower the error of the papers' pooling, but not by what the symbols say.**
Weighted by QTC states, the joint ADE of people who interact is lower by 7.5 ± 1.7 % in crowded
corridors and by 3.2 ± 0.6 % on zara2. Weights of the wrong pairs do as well (the right ones are
better by 0.5 ± 1.3 % and 0.3 ± 0.6 %), and so does `cnd` without a threshold, which is 1/15 for
nearly every pair (0.8 ± 1.4 % and 0.2 ± 0.7 %): what all three share is that the pooling's inputs
become small. A network whose attention sees how neighbours move gains nothing from the weights
(+0.2 ± 0.9 and +0.6 ± 1.0 %). As inputs of an attention, symbols alone are worth 11.1 ± 0.5 % in
corridors, geometry 23.7 ± 0.7 %, and symbols beside geometry change less than 2 % on both data
(−0.4 ± 1.0 and −0.5 ± 1.1 %).

These are all 24 seeds that were planned. On zara2, what symbols alone are worth is not answered by
the rules: 4 of their 24 networks do not react to enough neighbours. The other 20 gain 3.0 ± 0.8 %,
all 24 gain 2.7 ± 0.8 %. The study sees small effects: where simulated people react to states with a
twentieth of the full strength, the right weights lower the error by 5.8 ± 2.9 %. The first part
could not ask about the papers' pooling: its networks ignored their neighbours (dead ReLUs)."""
"""Written by hand from the numbers; check it when they change."""

TEXT = """# Does symbolic weighting help?

{answer}

The rules were written before the runs: the [protocol](weighting_protocol.md). A network whose
forecasts ignore neighbours is left out of all comparisons (runs left out: {dead}).

![Differences between arms in joint ADE, with intervals over seeds](weighting.png)

Joint ADE (best of 20) of people who interact: somebody within 2 m comes nearer. The difference is
in per cent of the second arm's error; below 0 the first arm is better. Intervals are Student's t
over seeds. The band is ±2 %, the smallest difference of interest. Grey is not answered: more than a
tenth of an arm's runs are left out.

## The questions

p values of these comparisons are corrected together (Holm).

{primary}

## Other comparisons

They have no influence on the answer; p values are not corrected.

{further}

## Symbols as inputs

Joint ADE of interacting people for the four sets of inputs of an attention.

![Errors without and with symbols and geometry](weighting_inputs.png)

## Where symbols might matter

People to whom an event happens in the true future.

![Differences by event](weighting_events.png)

Pooled at every predicted step, with the symbols of the predicted positions. These trainings are
unstable: runs with more than twice their arm's median error are left out ({diverged}).

{every}

A step of such a training takes 6 times (`encounter`) and 16 times (the papers' pooling) as long as
one that pools once. The symbols add 20 and 9 % to it (`python -m studies.weighting.price DATA`).

Trained on a tenth of the scenes:

{tenths}

## What the study can see

In simulations, people react to certain states of a pair only, and weakly (20, 10 and 5 % of the
full reaction). `right` weights exactly these pairs.

{weak}

<details markdown="1">
<summary>How this was measured</summary>

    NPROC=1 python -m studies.weighting DATA docs/weighting.csv

trains and tests the runs that the table lacks, and writes this page. DATA holds HERMES's runs in
`hermes` (`datasets/HERMES` of crowdbotp/OpenTraj) and ETH/UCY in `eth_ucy`. A deleted run,
repeated with the same versions, has the same bits.

</details>
"""
