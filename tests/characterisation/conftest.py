"""The option that writes the numbers of the stages anew."""

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--record", action="store_true", help="write tests/characterisation/recorded.json")
