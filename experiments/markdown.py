"""Parts of the tables of the documentation: rows of a CSV file in, text out."""

import numpy as np


def markdown(header, rows):
    """A markdown table of texts. Every row must have as many cells as the header."""
    for row in rows:
        if len(row) != len(header):
            raise ValueError(f"row {row} has {len(row)} cells, the header has {len(header)}")
    lines = [header, ["---"] * len(header), *rows]
    lines = [[cell.replace("|", "\\|") for cell in line] for line in lines]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def select(rows, **wanted):
    """The rows that have those values in those columns."""
    return [row for row in rows if all(row[key] == value for key, value in wanted.items())]


def percentages(rows, column):
    """That column's fractions [%], one a row, in the rows' order."""
    return [100 * float(row[column]) for row in rows]


def mean_and_worst(values):
    """The mean and the worst of percentages; one number where all are the same, - for none."""
    if not values:
        return "-"
    if min(values) == max(values):
        return f"{values[0]:.1f} %"
    return f"{np.mean(values):.1f} % ({min(values):.1f} %)"


def worst_first(values, form="{:.0f}"):
    """Numbers in ascending order, and their mean in bold."""
    each = ", ".join(form.format(value) for value in sorted(values))
    return f"{each}: **{np.mean(values):.1f}**"


def with_interval(row, name=""):
    """A success rate [%] and its 95 % interval. name: of the rate, where a row holds several."""
    prefix = f"{name}_" if name else ""
    success, low, high = (100 * float(row[f"{prefix}{key}"]) for key in ("success", "low", "high"))
    return f"{success:.1f} % [{low:.1f}, {high:.1f}]"
