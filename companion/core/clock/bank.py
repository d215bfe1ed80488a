"""All remote clocks, and the conversion of their stamps to host time."""

from __future__ import annotations

from companion.core.clock.remote_clock import RemoteClockEstimator
from companion.records import ClockName, ClockRestart, ClockState, Ints, Reject, TimesyncReply


class ClockBank:
    """One estimator per remote clock (the autopilot, every wing node, every camera).

    Ask each remote for TIMESYNC about ten times a second. The bound shrinks with the shortest round trip of a minute. A
    restarted clock is locked again after eight answers or 1.5 s. One that was known well is locked again when its bound
    is about what it was, or after 1.5 s.
    """

    def __init__(self) -> None:
        self._remotes: dict[ClockName, RemoteClockEstimator] = {}
        self._identities = {ClockName.HOST}

    def exchange(self, reply: TimesyncReply) -> ClockState:
        """Add one answered exchange and give the new state of that clock.

        A round trip that is negative or longer than a second is discarded.
        """
        return self._remote(reply.clock).exchange(reply)

    def restart(self, event: ClockRestart) -> ClockState:
        """Forget a clock whose owner has restarted; until it is locked again its stamps are refused."""
        return self._remote(event.clock).restart(event.seen_host_ns)

    def identity(self, clock: ClockName) -> None:
        """Declare that this clock stands in for the host's (a log with a single clock)."""
        self._identities.add(clock)

    def to_host(self, clock: ClockName, t_ns: Ints, received_host_ns: int | None = None) -> tuple[Ints, int] | Reject:
        """Convert stamps to host time.

        Parameters
        ----------
        clock : ClockName
            Clock of the stamps.
        t_ns : (n,) int64
            Stamps on ``clock``, in any order.
        received_host_ns : int, optional
            Time of their arrival, for live samples. They are refused if the newest is in the future, or more than half
            a second old, so that a restarted clock gives no wrong stamps before its restart is noticed. Older stamps
            may come with it.

        Returns
        -------
        (n,) int64 and int, or Reject
            Host stamps and the bound [ns] of their error; or ``CLOCK_UNSYNCED`` (never locked, suspended by a
            contradiction, or silent for 5 s with a bound above 2 ms); or ``TIME_BACKWARDS`` (stamps from before the
            first exchange, or too old on arrival).
        """
        if clock in self._identities:
            return t_ns, 0
        remote = self._remotes.get(clock)
        return Reject.CLOCK_UNSYNCED if remote is None else remote.to_host(t_ns, received_host_ns)

    def state(self, clock: ClockName, now_host_ns: int | None = None) -> ClockState:
        """Give the state of a clock, at ``now_host_ns`` or at its last exchange."""
        if clock in self._identities:
            return ClockState(clock, now_host_ns or 0, 0, 0.0, 0, True)
        return self._remote(clock).state(now_host_ns)

    def synced(self, clock: ClockName) -> bool:
        """Whether stamps of a clock can be converted, as of its last exchange."""
        return clock in self._identities or self._remote(clock).synced()

    def restarts(self, clock: ClockName) -> int:
        """Number of restarts of a clock, announced or found from exchanges that contradict all older ones."""
        return self._remote(clock).restarts

    def counters(self) -> dict[str, int]:
        """Count restarts seen and exchanges discarded, over all clocks."""
        remotes = self._remotes.values()
        return {
            "clock_restarts": sum(remote.restarts for remote in remotes),
            "timesync_discarded": sum(remote.discarded for remote in remotes),
        }

    def _remote(self, clock: ClockName) -> RemoteClockEstimator:
        if clock not in self._remotes:
            self._remotes[clock] = RemoteClockEstimator(clock)
        return self._remotes[clock]
