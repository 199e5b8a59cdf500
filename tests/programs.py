"""Programs of the repository that are no modules of the package, for tests."""

import importlib.util


def load_program(path):
    """Load a program from its path, and return it as a module that is not in `sys.modules`."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
