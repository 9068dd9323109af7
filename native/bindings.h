// What the parts of the Python bindings share.
#ifndef DASHPOT_BINDINGS_H
#define DASHPOT_BINDINGS_H

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include "dashpot_faults.h"
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

// The faults of one run, with what they remember; used by one run at a time.
struct Faults {
    dp_faults f{};
};

// The robot's side of a link to a controller in another process.
struct Link {
    dp_link l{};
};

// Checks that the drives' indices are within the engine's state, and those of their controls below a number.
void check_drives(const dp_run_args &a, const Vector &qpos, const Vector &qvel, int controls);

// Sets and checks what every run of a scenario needs; the arrays must outlive the run.
void fill(dp_run_args &a, Core *core, Bytes drives, Bytes events, Vector qpos, Vector qvel, double dt, int steps_per_tick,
          int ticks, nb::object reference, nb::object external, nb::object record, nb::object status, Faults *faults,
          Guard *guard);

void bind_arm(nb::module_ &m);    // bindings_arm.cpp
void bind_lists(nb::module_ &m);  // the same
void bind_cycle(nb::module_ &m);  // bindings_cycle.cpp
void bind_lanes(nb::module_ &m);  // bindings_lanes.cpp
void bind_measures(nb::module_ &m);  // bindings_measures.cpp

#endif
