"""Settings of the whole suite: the same examples in every run; `pytest --hypothesis-profile=hunt` looks for new ones."""

from hypothesis import settings

settings.register_profile("same", deadline=None, derandomize=True)
settings.register_profile("hunt", deadline=None, max_examples=3000)
settings.load_profile("same")
