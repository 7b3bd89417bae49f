"""A cloud that comes in a form, as files for as long as it is looked at."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from starlette.datastructures import UploadFile
from starlette.exceptions import HTTPException
from starlette.requests import Request

from halfseen.serving.refusal import Refusal


class CloudGiven(NamedTuple):
    """What the form holds."""

    cloud: Path
    """With the ending of the name that it was sent by."""
    labels: Path | None
    """What looks dirty."""
    stage: int | None
    """The stage to decide, from 1."""


@asynccontextmanager
async def cloud_in(request: Request) -> AsyncIterator[CloudGiven]:
    """Keep the files of a form for a while.

    Raises
    ------
    Refusal
        It is no form, holds no cloud, or a stage that is no number.
    """
    form = await _form(request)
    try:
        with TemporaryDirectory() as folder:
            cloud, labels = [await _kept(name, form.get(name), Path(folder)) for name in ("cloud", "labels")]
            if cloud is None:
                raise Refusal(422, "the form has no file 'cloud'; give one whose name ends in .pcd, .ply or .npz")
            yield CloudGiven(cloud, labels, _stage(form.get("stage")))
    finally:
        await form.close()


async def _form(request: Request) -> Any:
    try:
        return await request.form(max_files=2, max_fields=1, max_part_size=1 << 10)
    except HTTPException as error:
        raise Refusal(
            400, f"the request is no multipart form ({error.detail}); give cloud, labels and stage"
        ) from error


def _stage(given: Any) -> int | None:
    if given is None:
        return None
    if not (isinstance(given, str) and given.isascii() and given.isdigit() and len(given) < 10):
        raise Refusal(422, f"stage is {str(given)[:20]!r}; it is a whole number from 1")
    return int(given)


async def _kept(name: str, given: Any, folder: Path) -> Path | None:
    """Write a file of a form where what reads files finds it."""
    if not isinstance(given, UploadFile):
        return None
    ending = PurePosixPath(given.filename or "").suffix
    file = folder / f"{name}{ending if ending[1:].isalnum() and len(ending) < 10 else ''}"
    file.write_bytes(await given.read())
    return file
