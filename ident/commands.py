"""The commands around a real machine, for `cli`: import. Each parses, calls and prints."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable

from ident.errors import IdentError

#: Returns the parser of a new command: its name and what it does.
_NewCommand = Callable[[str, str], argparse.ArgumentParser]


def add(command: _NewCommand) -> None:
    """Adds the commands to the command line; each sets `action`, which takes the options and returns the exit status."""
    bring = command("import", "Bring measured records of a real machine into a campaign file, as a map.toml says.")
    bring.add_argument("files", metavar="FILE", nargs="+", help="records: MAT, CSV, NPZ or HDF5, one a record")
    bring.add_argument("--map", metavar="map.toml", help="which numbers are the torque and the angles of which joint")
    bring.add_argument("-o", dest="out", metavar="FILE.h5", help="the campaign file to write")
    bring.add_argument("--guess", action="store_true", help="print a first map.toml, to be checked by a person")
    bring.add_argument("--urdf", metavar="URDF", help="with --guess: the declared robot")
    bring.set_defaults(action=_import)


def _import(options: argparse.Namespace) -> int:
    from ident.importing import import_files
    from ident.mapping import load_map
    from ident.store import write_campaign

    if options.guess:
        return _guess(options)
    if options.map is None:
        raise IdentError("import: --map is missing; expected a map.toml (--guess prints a first one)")
    if options.out is None:
        raise IdentError("import: -o is missing; expected the campaign file to write")
    found = import_files(load_map(options.map), options.files)
    write_campaign(found.campaign, options.out)
    if options.json:
        ids = [record.id for record in found.campaign.records]
        print(json.dumps({"campaign": options.out, "kind": "campaign", "records": ids, "notes": found.notes}))
        return 0
    for line in found.records:
        print(line)
    for note in found.notes:
        print(f"! {note}", file=sys.stderr)
    print(f"{options.out}: {len(found.campaign.records)} records, {found.campaign.source}")
    return 0


def _guess(options: argparse.Namespace) -> int:
    from ident.guess import guess

    for name in ("map", "out"):
        if getattr(options, name) is not None:
            raise IdentError(
                f"import: {'-o' if name == 'out' else '--map'} does not go with --guess, which prints a map"
            )
    text = guess(options.files, options.urdf)
    print(json.dumps({"map": text}) if options.json else text, end="\n" if options.json else "")
    return 0
