"""Registrations with the trained models, honest and spoilt  -> archive/, RESULTS.md.

python -m learned --foreign FOREIGN --make 0:58                   # foreign pairs by number, resumable (foreign.toml)
python -m learned --data DATA --foreign FOREIGN                   # measure; --jobs processes side by side
python -m learned --data DATA --foreign FOREIGN --method NAME     # that method alone; the others' rows are kept
python -m learned --page                                          # write the page of what was measured
"""

import argparse
from dataclasses import replace
from pathlib import Path

from common import commit, read_archive, write_archive
from learned.cases import make_foreign
from learned.page import write_page
from learned.run import METHODS, Events, measure
from tissuereg._base.machine import machine, versions
from tissuereg.phantom import SHIPPED_MODELS, shipped_model_folder
from tissuereg.registration.learned.card import read_card

HERE = Path(__file__).resolve().parent
ARCHIVE, TABLES = HERE / "archive", ("rows/#",)


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--data", type=Path, default=Path("build/phantom-data"), help="whose test split is known physics"
    )
    parser.add_argument("--foreign", type=Path, default=Path("build/foreign"))
    parser.add_argument("--make", help="numbers of the files of foreign pairs that are made, as first:last:step")
    parser.add_argument("--first", type=int, default=0, help="first file of foreign pairs that is asked")
    parser.add_argument("--share", type=float, default=1.0, help="share of the events")
    parser.add_argument("--method", choices=METHODS, help="measure it alone, and keep the rows of the others")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=ARCHIVE)
    parser.add_argument("--page", action="store_true", help="measure nothing: write the page of what was measured")
    options = parser.parse_args()
    if options.make:
        make_foreign(options.foreign, range(*(int(word) for word in options.make.split(":"))))
        return
    if not options.page:
        events = Events(options.data, options.foreign, options.first)
        fewer = {
            name: max(1, round(options.share * getattr(events, name)))
            for name in ("known", "demo", "others", "off", "spoilt")
        }
        events = replace(events, **fewer)
        rows = measure(events, list(METHODS) if options.method is None else [options.method], options.jobs)
        if options.method is not None:
            rows += [row for row in read_archive(options.out)["rows"] if row["method"] != options.method]
            rows.sort(key=lambda row: list(METHODS).index(row["method"]))
        models = {name: read_card(shipped_model_folder(name)) for name in SHIPPED_MODELS}
        found = {
            "schema": "tissuereg.learned/1",
            **commit(),
            "models": {
                name: {key: card[key] for key in ("kind", "trained_on", "errors_mm")} for name, card in models.items()
            },
            "first_foreign": options.first,
            "machine": machine(),
            "versions": versions(),
            "rows": rows,
        }
        write_archive(options.out, found, TABLES)
    if options.out == ARCHIVE:
        write_page(read_archive(options.out))


if __name__ == "__main__":
    main()
