"""What a built page depends on, as a digest: another source, another digest."""

import hashlib
from pathlib import Path


def digest_of(root: Path, *folders: str) -> str:
    """Digest of all files below these folders, their names and bytes; compiled Python aside."""
    digest = hashlib.sha256()
    for folder in folders:
        for file in sorted((root / folder).rglob("*")):
            if file.is_file() and "__pycache__" not in file.parts:
                digest.update(f"{file.relative_to(root).as_posix()}\0{file.stat().st_size}\0".encode())
                digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
