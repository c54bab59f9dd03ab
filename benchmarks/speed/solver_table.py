"""The tables of `RESULTS.md` made from `archive/solver`: all figures there are these."""

#: Goals: cold and warm in floors at two threads, peak memory in MiB.
COLD = {"dome_4k_pull": 7, "dome_4k_push": 10, "dome_4k_pull_nu049": 10, "dome_4k_pull_x2": 10, "dome_20k_pull": 2.8}
WARM = {"dome_4k_pull": 3, "dome_4k_push": 6, "dome_4k_pull_nu049": 6}
MEMORY = {"dome_4k_pull": 60, "dome_20k_pull": 350, "100k": 3072}


def tables(answer: dict) -> str:
    """Return all tables as Markdown."""
    floor, many, sizes = answer["floor"], answer["many"], answer["sizes"]
    rates = "; ".join(
        f"{name} {floor[key]['1']:.0f} / {floor[key]['2']:.0f} {unit}"
        for name, key, unit in (
            ("dgemm", "dgemm_gflops", "GFLOP/s"),
            ("sgemm", "sgemm_gflops", "GFLOP/s"),
            ("triad", "triad_gb_per_s", "GB/s"),
        )
    )
    floors = ", ".join(
        f"{name} {1e3 * work / floor['dgemm_gflops']['2']:.1f} ms" for name, work in floor["gflop"].items()
    )
    machine = answer["machine"]
    lines = [
        f"`{answer['command']}`, {answer['date'][:10]}, commit {answer['commit']}, {machine['processor']}, "
        f"{machine['cores']} cores{'; **a smoke run, figures mean nothing**' if answer['quick'] else ''}.",
        f"One / two threads: {rates}. Floor (one Cholesky, METIS ordering, dgemm rate of two threads): {floors}.",
        "",
        "Medians in ms, minimum in brackets; residual over load 1e-6; *off*: largest distance from the reference.",
        "",
        "| problem | threads | cold | floors (goal) | warm | floors (goal) | off, mm "
        "| iterations, factorisations | peak MiB: process, ours (goal) |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        *map(_solve_row, answer["solves"]),
        "",
        "Peak after one cold solve: the whole process, and without what Python, NumPy and the arrays held before.",
        *sorted({f"{row['name']}:{_measured_later(row)}" for row in answer["solves"] if "floor" in row}),
        "",
        "Many solves on one mesh (4k nodes, E 10-60 kPa, one to three random patches, 2 to 25 mm to first order, two "
        f"threads): {_many(many)}",
        "",
        "| half ellipsoid | nodes | cold | analyse, factor, iterate | iterations, factorisations "
        "| peak MiB: process, ours (goal) |",
        "| --- | --- | --- | --- | --- | --- |",
        *map(_size_row, [*sizes["rows"], answer["tet10"]]),
        "",
        "Growth exponent over these sizes: "
        + ", ".join(f"{kind} {value:.2f}" for kind, value in sizes["growth_exponent"].items())
        + f" (least squares in logarithms; meshes of seed {sizes['seed']}).",
        "",
        "| program | settings | problem | threads | cold, ms | times ours | off, mm "
        "| iterations, factorisations | peak MiB |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
        *(_peer_row(row, answer) for row in answer["peers"]),
        *map(_elsewhere_row, answer["peers_elsewhere"]),
        "",
        *(f"* Not in this run: {row['name']} ({row['reason']})." for row in answer["peers_skipped"]),
        *sorted({f"* {row['version']}: {row['law']}." for row in answer["peers"] if "law" in row}),
    ]
    return "\n".join(lines).rstrip() + "\n"


def _ms(seconds: dict) -> str:
    return f"{_short(1e3 * seconds['median'])} ({_short(1e3 * seconds['minimum'])})"


def _short(value: float) -> str:
    return f"{value:.1f}" if value < 100 else f"{value:,.0f}"


def _goal(value: float, goal: float | None, digits: int = 1) -> str:
    return f"{value:.{digits}f}" + (f" ({goal})" if goal else "")


def _memory(row: dict) -> str:
    goal = MEMORY.get(row["name"])
    return f"{row['peak_mib']:.0f}, {row['peak_mib'] - row['peak_before_mib']:.0f}" + (f" ({goal})" if goal else "")


def _off(row: dict) -> str:
    return "" if row.get("difference_mm") is None else f"{row['difference_mm']:.1e}"


def _counts(counters: dict) -> str:
    steps = counters.get("load_steps") or 1
    summary = ("?" if counters[name] is None else str(counters[name]) for name in ("iterations", "factorisations"))
    return ", ".join(summary) + (f" in {steps} load steps" if steps > 1 else "")


def _solve_row(row: dict) -> str:
    name, two = row["name"], row["threads"] == 2
    if "error" in row:
        return f"| {name} | {row['threads']} | failed: {row['error']} | | | | | | |"
    cold, warm = (
        _goal(row["floors"][kind], goals.get(name) if two else None) for kind, goals in (("cold", COLD), ("warm", WARM))
    )
    cells = [name, str(row["threads"]), _ms(row["cold_s"]), cold, _ms(row["warm_s"]), warm, _off(row)]
    return _line([*cells, _counts(row["counters"]), _memory(row)])


def _many(many: dict) -> str:
    if "error" in many:
        return f"failed: {many['error']}."
    moved = many["largest_mm"]
    return (
        f"**{many['ms_a_member']:.1f} ms** a member (goal 15), {many['members']} members, {many['failed']} failed "
        f"({100 * many['failed'] / many['members']:.1f} %); largest displacement of a member "
        f"{moved['0']:.1f} / {moved['50']:.1f} / "
        f"{moved['100']:.1f} mm (least, median, most); {many['counters_a_member']['iterations']:.1f} iterations, "
        f"{many['counters_a_member']['factorisations']:.2f} factorisations a member.{_measured_later(many)}"
    )


def _measured_later(row: dict) -> str:
    """Return when a row was measured on its own, and how fast the machine was then."""
    if "floor" not in row:
        return ""
    dgemm = " / ".join(f"{row['floor']['dgemm_gflops'][n]:.0f}" for n in ("1", "2"))
    return f" Measured again, {row['date'][:10]}, commit {row['commit']}, with dgemm at {dgemm} GFLOP/s."


def _size_row(row: dict) -> str:
    if "error" in row:
        return f"| {row['name']} | | failed: {row['error']} | | | |"
    stages = ", ".join(_short(1e3 * row["stages_s"][name]) for name in ("analyse", "factor", "iterate"))
    cells = [row["name"], str(row["n_nodes"]), _ms(row["cold_s"]), stages, _counts(row["counters"])]
    return _line([*cells, _memory(row)])


def _peer_row(row: dict, answer: dict) -> str:
    if "error" in row:
        return _line(
            [row["name"], "", row["problem"], str(row["threads"]), f"failed: {row['error'][:80]}", "", "", "", ""]
        )
    same = [
        x
        for x in answer["solves"]
        if (x["name"], x["threads"]) == (row["problem"], row["threads"]) and "error" not in x
    ]
    ours = same[0] if same else answer["tet10"] if row["element"] == "tet10" else None
    # A ratio holds within one run alone: ours may have been measured again since.
    together = ours and "error" not in ours and "floor" not in ours
    ratio = f"{row['cold_s']['median'] / ours['cold_s']['median']:.0f}" if together else ""
    cells = [row["version"], row["settings"], row["problem"], str(row["threads"]), _ms(row["cold_s"]), ratio, _off(row)]
    return _line([*cells, _counts(row["counters"]), f"{row['peak_mib']:.0f}"])


def _elsewhere_row(row: dict) -> str:
    times = " / ".join(f"{1e3 * seconds:.0f}" for seconds in row["cold_s"].values())
    cells = [
        row["name"],
        row["settings"],
        row["problem"],
        " / ".join(row["cold_s"]),
        f"{times}, *another run and machine*",
    ]
    return _line([*cells, "", "", "", ""])


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"
