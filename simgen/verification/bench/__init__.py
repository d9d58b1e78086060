"""Speed against error: the same presses with each setting that a user can choose, on this machine (``simgen bench``).

``settings`` lists the settings. ``measure`` times them and compares them with the finest mesh. ``advice`` picks the
fastest ones. ``picture`` draws the plot.
"""

from collections.abc import Callable
from pathlib import Path

from simgen.config.warp_device import check_device
from simgen.errors import InputError

__all__ = ["run"]


def run(quick: bool, device: str, output: Path, say: Callable[[str], None]) -> None:
    """Measure all settings and write speed.csv, speed.png and advice.txt into the folder ``output``.

    ``say`` gets a line for each setting. Raises InputError for a missing device and a folder that cannot be made.
    """
    from simgen.verification.bench.advice import advice
    from simgen.verification.bench.measure import measure_all, write_csv
    from simgen.verification.bench.picture import draw

    check_device(device)
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--output {output}: no folder can be made there ({error.strerror})") from None
    rows = measure_all(quick, device, say)
    write_csv(rows, output / "speed.csv")
    draw(rows, output / "speed.png")
    sentence = advice(rows)
    (output / "advice.txt").write_text(sentence + "\n", encoding="utf-8")
    say(sentence)
    say(f"wrote {output / 'speed.csv'}, {output / 'speed.png'} and {output / 'advice.txt'}")
