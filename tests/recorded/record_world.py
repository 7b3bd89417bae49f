"""What the world does with given keys: episodes, stage by stage; ran at commit a5c2804.

python tests/recorded/record_world.py
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from recorded.world_cases import leaves, played, scenes

HERE = Path(__file__).parent


def main():
    """Play, and write world.npz."""
    arrays = {}
    for k, scene in enumerate(scenes()):
        arrays |= {f"scene{k}/hides": scene.hides, f"scene{k}/grip": scene.grip, f"scene{k}/places_m": scene.places_m}
    for name, (_, episodes) in played().items():
        found = leaves(episodes, "")
        taken = found["is_taken"]
        for what, value in found.items():
            is_stage = value.shape[:2] == taken.shape
            if is_stage and what != "is_taken":
                value = np.where(taken.reshape(*taken.shape, *(1,) * (value.ndim - 2)), value, value[:, :1])
                if (value == value[:, :1]).all() and what not in ("action", "reward"):
                    what, value = f"{what} (still)", value[:, 0]
            arrays[f"{name}/{what}"] = value
        print(name, int(taken.sum()), sum(v.nbytes for k, v in arrays.items() if k.startswith(name)), flush=True)
    np.savez_compressed(HERE / "world.npz", **arrays)
    print(len(arrays), (HERE / "world.npz").stat().st_size)


if __name__ == "__main__":
    main()
