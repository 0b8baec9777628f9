"""How long each tutorial takes to its first figure, from a fresh Python on: by the clock, and of the processors.

Run:
python -m validation.benchmarks.tutorials  (half a minute; by the clock it means something on a quiet machine only)
"""

from __future__ import annotations

import multiprocessing
import os
import re
import resource
import runpy
import tempfile
import time
from pathlib import Path

PAGES = Path(__file__).parents[2] / "docs/tutorials"
CODE = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def processor_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def run(path: str) -> None:
    os.chdir(Path(path).parent)
    runpy.run_path(path)


def main() -> None:
    context = multiprocessing.get_context("spawn")
    for page in sorted(PAGES.glob("*.md")):
        code = "\n".join(CODE.findall(page.read_text()))
        if not code:
            continue
        with tempfile.TemporaryDirectory() as folder:
            script = Path(folder) / "first.py"
            script.write_text(f"{code}\nfigure.savefig({folder + '/first.png'!r})\n")
            begin, used = time.perf_counter(), processor_s()
            one = context.Process(target=run, args=(str(script),))
            one.start()
            one.join()
            took = f"{time.perf_counter() - begin:.1f} s, {processor_s() - used:.1f} s of the processors"
            print(f"{page.stem}: {took if one.exitcode == 0 else 'failed'}", flush=True)


if __name__ == "__main__":
    main()
