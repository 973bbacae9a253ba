"""Writes GIFs with one palette for all frames, without bands or flicker."""

import io
from typing import Any

import numpy as np
from matplotlib.animation import AbstractMovieWriter
from PIL import Image

SAMPLE = 8
"""Pictures from which the palette is made."""


class GifWriter(AbstractMovieWriter):
    """Collects the pictures of an animation, and writes them when it ends."""

    def setup(self, fig: Any, outfile: Any, dpi: float | None = None) -> None:
        """Begin; see matplotlib."""
        super().setup(fig, outfile, dpi)  # pyright: ignore[reportAbstractUsage] - the stubs forget its body
        self._images: list[Image.Image] = []

    def grab_frame(self, **savefig_kwargs: Any) -> None:
        """Add the figure as it is now."""
        file = io.BytesIO()
        self.fig.savefig(file, dpi=self.dpi, format="rgba", **savefig_kwargs)
        width, height = map(int, self.frame_size)
        self._images.append(
            Image.frombuffer("RGBA", (width, height), file.getvalue(), "raw", "RGBA", 0, 1).convert("RGB")
        )

    def finish(self) -> None:
        """Write the file."""
        palette = shared_palette(self._images)
        first, *rest = (image.quantize(palette=palette, dither=Image.Dither.NONE) for image in self._images)
        first.save(self.outfile, format="GIF", save_all=True, append_images=rest, duration=1000 // self.fps, loop=0)


def shared_palette(images: list[Image.Image]) -> Image.Image:
    """An image with the 256 colours that suit all pictures best, found from an even selection of them."""
    chosen = [images[index] for index in np.unique(np.linspace(0, len(images) - 1, SAMPLE).round().astype(int))]
    return Image.fromarray(np.concatenate([np.asarray(image) for image in chosen])).quantize(256)
