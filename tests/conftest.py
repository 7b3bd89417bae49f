"""Tests of one file run in one process, and so do all that ask for the one small study."""

import pytest


def pytest_collection_modifyitems(items):
    for item in items:
        asks_for_study = "study_folder" in getattr(item, "fixturenames", ())
        item.add_marker(pytest.mark.xdist_group("the small study" if asks_for_study else str(item.path)))
