"""A figure of matplotlib that notebooks show without pyplot, whose state a library should not touch."""

import io

from matplotlib.figure import Figure


class ShownFigure(Figure):
    """Shown as a picture where a cell of a notebook ends with it."""

    def _repr_png_(self) -> bytes:
        stream = io.BytesIO()
        self.savefig(stream, format="png", dpi=100, metadata={"Software": None})
        return stream.getvalue()
