"""The words of the page: what is not computed."""

__all__ = ["ANSWER", "TEXT"]

ANSWER = """\
**At some places the papers' weights lower the error of the papers' pooling, over six places that is
open; and it is hardly what the symbols say that does it.** Errors are those of people who interact.

1. Trained for ADE and FDE, best of 10, QTC weights lower the joint ADE (best of 20) of the papers'
   pooling by 7.5 ± 1.7 % in HERMES's corridors and by 3.2 ± 0.6 % on zara2. Over [six
   places](#at-six-places) the difference is −3.3 ± 5.3 %: from −11 % to +3 %.
2. Whose weights they are is not shown to matter: right pairs beat wrong ones by 0.7 ± 1.2 % in
   joint ADE and 1.5 ± 2.2 % in energy score over six places, by 0.9 ± 0.6 % in the latter on zara2.
3. Where an attention sees how neighbours move, symbols change its joint ADE by less than 2 % in the
   corridors and on zara2, as weights and as inputs; so does their [history](#symbols-over-time) on
   average.
4. As the only inputs of an attention in the corridors, symbols are worth 11.1 % of joint ADE,
   geometry 23.7 %.
5. No network here has the released loss, whose own comparison
   [changed the loss with the symbols](released_code.md#the-released-comparison)."""
"""Written by hand from the numbers; check it when they change."""

TEXT = """# Does symbolic weighting help?

{answer}

Each part's rules were committed before its first run; `studies/weighting/protocol.md` lists what
was amended meanwhile. Networks whose forecasts ignore neighbours are left out ({dead}).

![Differences between arms in joint ADE, with intervals over seeds](weighting.png)

Joint ADE of people who interact: somebody within 2 m comes nearer. Differences are in per cent of
the second arm's; below 0 the first is better. Bars, and what stands after ±, are 95 %
intervals over seeds (Student's t). The band is ±2 %, the smallest difference of interest. Grey is
not answered: more than a tenth of an arm's runs are left out.

## The arms

- `papers`: SGAN with the pooling that the [papers](models.md#neurosym) describe, all weights 1;
  recipe `ours` (ADE and FDE, best of 10), as is `encounter`.
- `papers, cnd`: a pair's weight is 1 / (neighbours of its state in the theory's diagram).
  `quantised`: so, with movements below 5 cm a step counted as none. `shuffled`: the weights of
  `quantised`, of the wrong pairs. `learned`: 81 free weights. `none`: no pooling.
- `anchors`: [our network](models.md#anchors), whose attention sees of neighbours `nothing`, QTC
  `symbols`, `geometry` (bearing, relative velocity, closest approach), or `both`.
- `encounter`: SGAN with an attention over that geometry; weighted as `papers`. `right`: weights for
  just the pairs to which simulated people react.

## The questions

{primary}

*p*: t test of no difference, and two one-sided t tests that it is within 2 %, corrected over these
comparisons (Holm). *Margin in reach*: within which nine of ten such studies would show equivalence.
[Energy scores](glossary.md#metrics) are secondary, not corrected.

## Other comparisons

Not corrected. Bold: within 2 % (p < .05). `cnd` and `shuffled` had 8 seeds before a look.

{further}

![Errors without and with symbols and geometry](weighting_inputs.png)

The axis does not begin at 0.

## At six places

Each left out of training, four seeds. Intervals are over seeds, in the last lines over places; of
these the first was planned (Holm, four tests).

{places}

## Where symbols might matter

Joint ADE of people to whom an event happens in the true future:

![Differences by event](weighting_events.png)

With a tenth of the scenes:

{tenths}

The study can see effects of 6 % of joint ADE: simulated people react to certain states of a pair
only, by 20, 10 and 5 % of the full reaction:

{weak}

## Symbols over time

**A pair's history of QTC states gains nothing beyond 2 % on average**, with or without geometry's,
which gains 1.6 ± 0.6 %. Places differ: in the corridors it lowers joint ADE beside geometry's; on
univ, without it, it raises the energy score.

{history}

All arms of `anchors` see the present geometry; the others add states (with durations and changes)
over 2.8 s, positions and velocities, or both. *p*: Holm. Eight
seeds became 19 after single errors, but before any comparison, had been seen.
"""
