"""Parameters in the words of a laboratory: m_xx is the scale of x, m_xy a cross-axis term, offset_y the offset of y."""

from collections.abc import Sequence


def in_words(names: Sequence[str]) -> str:
    """Return names of parameters in words, those of one kind together.

    Parameters
    ----------
    names : sequence of str
        m_xx .. m_zz, offset_x .. offset_z.

    Returns
    -------
    str
        As "scale of x and y, cross-axis term xy, offset of z".
    """
    ends = [(name.partition("_")[0], name.rpartition("_")[2]) for name in names]
    scales = [end[0] for head, end in ends if head == "m" and end[0] == end[-1]]
    crossed = [end for head, end in ends if head == "m" and end[0] != end[-1]]
    offsets = [end for head, end in ends if head == "offset"]
    parts = (
        f"scale of {_listed(scales)}" if scales else "",
        f"cross-axis term{'s' * (len(crossed) > 1)} {_listed(crossed)}" if crossed else "",
        f"offset of {_listed(offsets)}" if offsets else "",
    )
    return ", ".join(part for part in parts if part)


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
