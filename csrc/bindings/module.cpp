// The Python module of the C kernels. Each kernel file has its own binding file next to this one, which only moves
// arrays in and out; this file registers them.
#include <nanobind/nanobind.h>

namespace nb = nanobind;

void bind_figures(nb::module_ &m);
void bind_fit(nb::module_ &m);
void bind_law(nb::module_ &m);
void bind_loop(nb::module_ &m);
void bind_realtime(nb::module_ &m);
void bind_twin(nb::module_ &m);

NB_MODULE(_kernels, m) {
    m.doc() = "Compiled kernels of fraclink. Private: the package's Python modules are the interface.";
    // a cache of Python's that outlives the interpreter's last collection is no leak
    nb::set_leak_warnings(false);
    bind_figures(m);
    bind_fit(m);
    bind_law(m);
    bind_loop(m);
    bind_realtime(m);
    bind_twin(m);
}
