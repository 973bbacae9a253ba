"""Finds ffmpeg, which encodes MP4."""

import shutil

from mpsim.core.optional_packages import imported
from mpsim.errors import OutputError


def executable(instead: str) -> str:
    """The path of ffmpeg: the system's, or that of the package imageio-ffmpeg, which the extra `film` installs.

    Args:
        instead: what to do without ffmpeg, for the error.

    Raises:
        OutputError: if neither is found.
    """
    found = shutil.which("ffmpeg")
    if found is not None:
        return found
    package = imported("imageio_ffmpeg", "an .mp4", "film", f"install ffmpeg, or {instead}")
    try:
        return package.get_ffmpeg_exe()
    except RuntimeError as error:  # a build of the package without one
        raise OutputError(f"an .mp4 needs ffmpeg, which was not found ({error}). Install it, or {instead}.") from None
