"""Make lbacal_twin/mismatch.csv: in what two antennas of one station differ, from impedances measured at the LWA.

    .venv/bin/python validation/scripts/make_mismatch.py ../shared/data

ln of the power that the front end takes of one antenna over that of another of its station, (1 - |A|^2)(1 - |S|^2) /
|1 - A S|^2 with the reflections A of the antennas and S of the mean front end (DiLullo et al. 2023, arXiv 2303.14904).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

TARGET = Path(__file__).parents[2] / "lbacal_twin" / "mismatch.csv"
SOURCE = "# ln of the power of one antenna over another of its station, from DiLullo et al. 2023, arXiv 2303.14904"
PAIRS = {"LWA1": ("LWA1_204", "LWA1_9"), "LWASV": ("LWASV_162", "LWASV_92")}


def read(path: Path) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Frequencies, and S11 by the name of what was measured."""
    rows = path.read_text().splitlines()
    names, values = rows[1].split(","), np.array([row.split(",") for row in rows[2:]], dtype=float)
    ends = " S11 re"
    found = {
        n.removesuffix(ends): values[:, k] + 1j * values[:, k + 1] for k, n in enumerate(names) if n.endswith(ends)
    }
    return values[:, 0], found


def main(folder: str) -> None:
    nu, antennas = read(Path(folder) / "other/lwa_antennas.csv")
    _, front_ends = read(Path(folder) / "other/lwa_front_ends.csv")
    end = np.mean(list(front_ends.values()), axis=0)
    columns = {}
    for station, pair in PAIRS.items():
        for dipole in "AB":
            one, other = (
                np.log((1 - np.abs(s) ** 2) / np.abs(1 - s * end) ** 2)
                for name in pair
                for antenna, s in antennas.items()
                if antenna.startswith(f"{name}_") and antenna.endswith(dipole)
            )
            columns[f"{station} {dipole}"] = one - other
    for name, column in columns.items():
        inside = (nu >= 30) & (nu <= 80)
        print(name, f"r.m.s. / sqrt 2 at 30-80 MHz {100 * np.sqrt(np.mean(column[inside] ** 2) / 2):.1f} %")
    rows = [f"{f:g}," + ",".join(f"{column[k]:.4f}" for column in columns.values()) for k, f in enumerate(nu)]
    TARGET.write_text("\n".join([SOURCE, "frequency_mhz," + ",".join(columns), *rows]) + "\n")


if __name__ == "__main__":
    main(sys.argv[1])
