"""Human motion prediction in JAX: SGAN and NeuroSyM, as functions of one scene.

`__init__.pyi` beside this file, and beside that of every subpackage, lists what the
package exports; a name is imported when it is first asked for.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
