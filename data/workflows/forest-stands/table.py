#!/usr/bin/env python3
"""Joins the tables of single forests, densityD_seedS.csv, into one with the columns density and seed before theirs."""

import csv
import os
import re
import sys

target, *sources = sys.argv[1:]
partial = target + ".part"
with open(partial, "w", newline="") as file:
    writer = csv.writer(file, lineterminator="\n")
    head = None
    for source in sources:
        density, seed = re.fullmatch(r"density(.+)_seed(.+)\.csv", os.path.basename(source)).groups()
        with open(source, newline="") as table:
            names, *rows = csv.reader(table)
        if head is None:
            head = names
            writer.writerow(["density", "seed", *head])
        if names != head:
            sys.exit(f"{source}: its columns differ from those of {sources[0]}")
        writer.writerows([density, seed, *row] for row in rows)
os.replace(partial, target)
