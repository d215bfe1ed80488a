"""The filter's inner loop, in C: see :mod:`companion.core.tracking.filter` for its equations."""

from __future__ import annotations

from companion.core.kernels.arrays import DiscreteModel, Epochs, FilterConstants, FilterState, History
from companion.native.library import INTEGER, RECORD, kernel, packed

_filter = kernel("filter_epochs", RECORD, RECORD, RECORD, RECORD, RECORD, INTEGER, INTEGER, INTEGER)
_pack_constants, _pack_model, _pack_epochs = packed(FilterConstants), packed(DiscreteModel), packed(Epochs)
_pack_state, pack_history = packed(FilterState), packed(History)


def filter_epochs(
    const: FilterConstants,
    model: DiscreteModel,
    epochs: Epochs,
    filter_state: FilterState,
    history: History,
    first: int,
    last: int,
    steps: int,
) -> bool:
    """Filter the epochs ``first:last`` in place.

    Parameters
    ----------
    const : FilterConstants
        Constants of the airframe.
    model : DiscreteModel
        Model that the filter runs on.
    epochs : Epochs
        Measurements.
    filter_state : FilterState
        Updated in place.
    history : History
        Updated in place; epoch ``first`` is step ``steps``.
    first, last : int
        Range of epochs.
    steps : int
        Steps done before.

    Returns
    -------
    bool
        False where the innovation covariance is not positive definite or not finite: the filter has run away.
    """
    wing, measured = (_pack_constants(const), _pack_model(model)), _pack_epochs(epochs)
    past = pack_history(history)
    return bool(_filter(*wing, measured, _pack_state(filter_state), past, first, last, steps))
