"""Read what the wrapper wrote with `--policy.log=PATH`: one JSON line a chunk.

python examples/read_a_log.py PATH
"""

import json
import sys
from collections import defaultdict
from pathlib import Path
from statistics import fmean


def main(path: Path) -> None:
    """How often and how far each episode's chunks were edited, and what that took."""
    episodes = defaultdict(list)
    for line in path.read_text().splitlines():
        chunk = json.loads(line)
        episodes[chunk["episode"]].append(chunk)
    for number, chunks in sorted(episodes.items()):
        edited = [chunk for chunk in chunks if chunk["edited"]]
        first = f", the first at step {edited[0]['step']}" if edited else ""
        print(
            f"episode {number}: {len(edited)} of {len(chunks)} chunks edited{first}, "
            f"by {fmean([chunk['distance'] for chunk in edited] or [0.0]):.2f} on average, "
            f"{fmean(chunk['milliseconds'] for chunk in chunks):.1f} ms a chunk"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
