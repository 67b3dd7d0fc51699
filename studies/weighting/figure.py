"""The forest plot of the study: an arm a row, a data set a panel, the control first."""

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from neurosym_jax.plotting.style import INK, LABEL, SMALL, WIDTH, dress, model_looks, new_figure
from studies.weighting.comparison import MARGIN, Comparison

__all__ = ["forest"]


def forest(found: Mapping[str, Sequence[Comparison]], titles: Mapping[str, str]) -> Figure:
    """Differences from `ones` in per cent with their intervals, and the band of equivalence.

    Args:
        found: the comparisons of each set, in the order of the rows.
        titles: of the sets.
    """
    tallest = max(len(comparisons) for comparisons in found.values())
    figure, grid = new_figure(WIDTH, 0.9 + 0.25 * tallest, 1, len(found))
    arms = list(dict.fromkeys(each.arm for some in found.values() for each in some))
    # Those that have a colour of their own first, or others would take it.
    looks = model_looks(("quantised", "shuffled", "learned", "SGAN", *arms))
    for axes, (name, comparisons) in zip(grid[0], found.items()):
        dress(axes)
        axes.set_title(titles[name], fontsize=LABEL, color=INK, loc="left")
        axes.axvspan(-MARGIN, MARGIN, color="#EEEEEE", lw=0, zorder=0)
        axes.axvline(0, color="#888888", lw=0.8, zorder=1)
        for place, each in enumerate(comparisons):
            colour = looks[each.arm]["color"]
            axes.plot([each.low, each.high], [place, place], color=colour, lw=1.8)
            axes.plot(each.percent, place, color=colour, marker="D", ms=4, ls="none")
        labels = [f"{each.arm} ({each.seeds})" for each in comparisons]
        axes.set_yticks(range(len(labels)), labels, fontsize=SMALL, color=INK)
        axes.set_ylim(tallest - 0.4, -0.6)
        axes.grid(visible=False, axis="y")
        axes.spines["left"].set_visible(False)
        axes.xaxis.set_major_locator(MaxNLocator(4))
    words = "difference from `ones` in per cent of its error; left: better"
    figure.supxlabel(words, fontsize=LABEL, color=INK)
    return figure
