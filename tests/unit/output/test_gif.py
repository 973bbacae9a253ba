"""GIFs with one palette."""

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from mpsim.output.gif import GifWriter, shared_palette


def test_all_pictures_share_the_colours_of_all(tmp_path):
    figure = Figure(figsize=(1, 1), dpi=100)
    writer = GifWriter(fps=20)
    colours = ["#800000", "#008000", "#000080"]
    with writer.saving(figure, str(tmp_path / "a.gif"), 100):
        for colour in colours:
            figure.set_facecolor(colour)
            writer.grab_frame()
    with Image.open(tmp_path / "a.gif") as film:
        assert (film.n_frames, film.size, film.info["duration"]) == (3, (100, 100), 50)
        for index, colour in enumerate(colours):
            film.seek(index)
            assert film.convert("RGB").getpixel((5, 5)) == tuple(bytes.fromhex(colour[1:]))


def test_a_palette_of_one_picture_would_lack_the_colours_of_another():
    one, other = (Image.new("RGB", (9, 9), colour) for colour in ("red", "blue"))
    for images, kept in (([one, other], True), ([one], False)):
        found = other.quantize(palette=shared_palette(images), dither=Image.Dither.NONE).convert("RGB")
        assert (np.asarray(found)[0, 0].tolist() == [0, 0, 255]) == kept
