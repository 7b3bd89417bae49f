"""What the wheel stands on, as CycloneDX: names, versions and licences; no address that anything was loaded from."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any


def bill_of(python: Path) -> str:
    """Write down what is installed beside the wheel in a bare environment.

    Parameters
    ----------
    python
        Python of the environment.

    Returns
    -------
    str
        JSON; the same environment gives the same bytes.

    Raises
    ------
    ValueError
        It would be no bill of CycloneDX 1.6.
    """
    from cyclonedx.schema import SchemaVersion
    from cyclonedx.validation.json import JsonStrictValidator

    command = ["environment", "--output-reproducible", "--short-PURLs", "--sv", "1.6", "--of", "JSON", "-o", "-"]
    printed = subprocess.run(
        [sys.executable, "-m", "cyclonedx_py", *command, python], check=True, capture_output=True, text=True
    )
    bill = json.dumps(plain(json.loads(printed.stdout)), indent=1, sort_keys=True) + "\n"
    if (fault := JsonStrictValidator(SchemaVersion.V1_6).validate_str(bill)) is not None:
        raise ValueError(f"the bill is not as CycloneDX 1.6 asks for: {fault}")
    return bill


def plain(bill: dict[str, Any]) -> dict[str, Any]:
    """Make the wheel what the bill is of, and leave out where anything came from, and what installed it."""
    parts = {part["name"]: part for part in _without_addresses(bill["components"])}
    whole = parts.pop("halfseen")
    parts.pop("pip", None)
    known = {part["bom-ref"] for part in (whole, *parts.values())}
    return bill | {
        "metadata": {"component": whole | {"type": "application"}},
        "components": list(parts.values()),
        "dependencies": [each for each in bill["dependencies"] if each["ref"] in known],
    }


def _without_addresses(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_addresses(each) for key, each in value.items() if key != "externalReferences"}
    return [_without_addresses(each) for each in value] if isinstance(value, list) else value
