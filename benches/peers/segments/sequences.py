"""Labelled sequences as CSV files, and what of a truth is found in names: for the scripts beside this one."""
import csv
import gzip


def read(path):
    """Header and rows, without lines that begin with #."""
    with (gzip.open if path.suffix == ".gz" else open)(path, "rt", newline="") as file:
        rows = list(csv.reader(line for line in file if not line.startswith("#")))
    return rows[0], rows[1:]


def write(path, header, rows):
    """Writes what `read` reads."""
    with gzip.open(path, "wt", compresslevel=1, newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(header)
        out.writerows(rows)


def segments(labels):
    """Label, first frame and end of each run of equal labels."""
    out, first = [], 0
    for k in range(1, len(labels) + 1):
        if k == len(labels) or labels[k] != labels[first]:
            out.append((labels[first], first, k))
            first = k
    return out


def hits(truth, named, overlap):
    """How many segments of the truth are found, each by one named segment of its label that overlaps it (intersection over union) by so much; how many
    there are in both."""
    a, b = segments(truth), segments(named)
    taken = set()
    for c, first, end in b:
        best, at = 0.0, None
        for k, (d, f, e) in enumerate(a):
            if c == d:
                share = max(0, min(end, e) - max(first, f)) / (max(end, e) - min(first, f))
                if share > best:
                    best, at = share, k
        if best >= overlap:
            taken.add(at)
    return len(taken), len(a), len(b)
