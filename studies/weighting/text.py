"""The words of the page: what is not computed."""

__all__ = ["ANSWER", "TEXT"]

ANSWER = """\
**For a network that already sees how neighbours move: no. For the papers' own pooling: not known
yet.** The network `encounter` attends to each neighbour's bearing, relative velocity, and time and
distance of closest approach. Weighting its attention by QTC states changes the joint ADE of people
who interact by +0.2 % (−0.7 to +1.2) in crowded corridors and by +0.6 % (−0.4 to +1.6) on zara2:
less than the 2 % that the protocol had named as worth having. The symbols repeat what these
features say. In the control, where simulated people react to symbols, the right weighting lowers
their error by 61 %, so the study can see an effect.

The first part could not answer for the papers' pooling: its networks ignored their neighbours
(dead ReLUs). The second part asks again, with a pooling that is alive, and with symbols as inputs.
It is being run; the tables show what has three seeds or more."""
"""Written by hand from the numbers; check it when they change."""

TEXT = """# Does symbolic weighting help?

{answer}

The rules were written before the runs: the [protocol](weighting_protocol.md). A network whose
forecasts ignore neighbours is left out of all comparisons (runs left out: {dead}).

![Differences between arms in joint ADE, with intervals over seeds](weighting.png)

Joint ADE (best of 20) of people who interact: somebody within 2 m comes nearer. The difference is
in per cent of the second arm's error; below 0 the first arm is better. Intervals are Student's t
over seeds. The band is ±2 %, the smallest difference of interest.

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
