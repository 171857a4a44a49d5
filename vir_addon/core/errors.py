"""Errors that a user can act on. Every front end shows their text as it is; the command line maps them to exit statuses."""


class VirError(Exception):
    """Something the user can mend; the text names the thing and says what to do."""

    exit_status = 3


class UsageError(VirError):
    """The request itself is wrong: an unknown light, a map larger than the device allows, ..."""

    exit_status = 2


class SceneError(VirError):
    """The scene cannot be rendered: no camera, file unreadable or newer than this Blender, ..."""

    exit_status = 3


class DeviceError(VirError):
    """No usable device, the device refused, or a package is missing; says what to install or to change."""

    exit_status = 4
