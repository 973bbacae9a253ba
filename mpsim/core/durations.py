"""Durations as text, such as "2 min 5 s"."""


def duration(seconds: float) -> str:
    """A time in words.

    >>> duration(0.25), duration(42), duration(4000), duration(200000)
    ('0.2 s', '42 s', '1 h 06 min', '55 h 33 min')
    """
    if seconds < 100:
        return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s"
    hours, minutes = divmod(int(seconds / 60), 60)
    return f"{hours} h {minutes:02} min" if hours else f"{minutes} min"
