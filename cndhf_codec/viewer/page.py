"""The viewer's page with a `.cndhf` file in it.

`viewer.html` is made by `npm run viewer` in web/; whoever changes web/ makes it anew, and the tests of web/ compare.
"""

from __future__ import annotations

import base64
from html import escape
from importlib.resources import files

PLACE = '<script id="cndhf-file" type="text/plain"></script>'


def page(data: bytes, name: str) -> str:
    """The HTML of the viewer with a file in it, which it opens: one page that loads nothing else.

    data: the file's bytes, which are not checked: the page says what is wrong with them. name: what it calls them.

    >>> from cndhf_codec.viewer.page import page
    >>> page(b"not a file", "a.cndhf").count('data-name="a.cndhf">bm90IGEgZmlsZQ==</script>')
    1
    """
    before, place, after = files(__package__).joinpath("viewer.html").read_text("utf-8").partition(PLACE)
    assert place, "viewer.html has no place for a file"
    shown = escape(name.encode("utf-8", "replace").decode())  # a name that is no UTF-8 has surrogates
    inside = base64.b64encode(data).decode()
    return f'{before}{PLACE.removesuffix("></script>")} data-name="{shown}">{inside}</script>{after}'


class Frame:
    """The viewer with a model in it, for notebooks, which draw what has `_repr_html_`; elsewhere it is a line of text.

    Parameters
    ----------
    data : bytes
        A `.cndhf` file.
    name : str
        What the viewer calls it.
    height : int
        Of the frame, in CSS pixels; it is as wide as the notebook's cell.

    Examples
    --------
    >>> from cndhf_codec.viewer.page import Frame
    >>> Frame(b"", "model.cndhf", 480)
    <Viewer of model.cndhf: drawn in notebooks; elsewhere save the model, and run cndhf-view>
    """

    def __init__(self, data: bytes, name: str, height: int) -> None:
        self._data, self._name, self._height = data, name, height

    def __repr__(self) -> str:
        return f"<Viewer of {self._name}: drawn in notebooks; elsewhere save the model, and run cndhf-view>"

    def _repr_html_(self) -> str:
        # Without allow-same-origin, the page cannot touch the notebook.
        return (
            f'<iframe title="viewer of {escape(self._name)}" sandbox="allow-scripts allow-downloads" '
            f'style="width: 100%; height: {self._height}px; border: 0" '
            f'srcdoc="{escape(page(self._data, self._name))}"></iframe>'
        )
