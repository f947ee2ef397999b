// The Python module of the kernels of fracsys, as module.cpp is that of fraclink's.
#include <nanobind/nanobind.h>

namespace nb = nanobind;

void bind_minimax(nb::module_ &m);
void bind_modes(nb::module_ &m);

NB_MODULE(_kernels, m) {
    m.doc() = "Compiled kernels of fracsys. Private: the package's Python modules are the interface.";
    bind_minimax(m);
    bind_modes(m);
}
