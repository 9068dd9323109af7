// What the parts of the Python bindings share.
#ifndef DASHPOT_BINDINGS_H
#define DASHPOT_BINDINGS_H

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include "dashpot_link.h"
#include "dashpot_supervisor.h"

namespace nb = nanobind;

using Bytes = nb::ndarray<uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Array = nb::ndarray<double, nb::c_contig, nb::device::cpu>;
using Vector = nb::ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Square = nb::ndarray<double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Ints = nb::ndarray<int32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

// The C controller with the input array it reads from; both stay where they are.
struct Core {
    dp_controller c{};
    double in[DP_NIN * DP_MAX_JOINTS] = {};
    double out[DP_MAX_JOINTS] = {};
};

// The C supervisor with the ages it reads; the core it steers is kept alive by its Python object.
struct Guard {
    dp_supervisor s{};
    Core *core = nullptr;
    int32_t torque_age[DP_MAX_JOINTS] = {}, encoder_age[DP_MAX_JOINTS] = {};
};

// The robot's side of a link to a controller in another process.
struct Link {
    dp_link l{};
};

void bind_cycle(nb::module_ &m);  // bindings_cycle.cpp

#endif
