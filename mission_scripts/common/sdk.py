"""MAVSDK, which an optional extra brings: its names for the missions, and one sentence where it is not installed."""

from companion.errors import missing_extra

try:
    import mavsdk
    from mavsdk.logging import log_subscribe
    from mavsdk.plugins.action.action import Action
    from mavsdk.plugins.mavlink_direct.mavlink_direct import MavlinkDirect, MavlinkMessage
    from mavsdk.plugins.mission_raw.mission_raw import MissionItem, MissionRaw
except ImportError as error:
    raise SystemExit(missing_extra("mission scripts", "missions")) from error

__all__ = ["Action", "MavlinkDirect", "MavlinkMessage", "MissionItem", "MissionRaw", "log_subscribe", "mavsdk"]
