"""The colours of all figures."""

__all__ = ["PALETTE"]

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#4D4D4D")
"""Those of Okabe and Ito, safe for colour-blind readers, less the yellow that fades on white."""
