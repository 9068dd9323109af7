// Python binding of the arm alone, tick by tick.
#include "bindings.h"

#include <algorithm>
#include <stdexcept>

namespace {

// The engine's arrays and the faults are kept alive by the Python object around this one.
struct Arm {
    dp_run_args a{};
    dp_drive drive[DP_MAX_JOINTS] = {};
    double record[DP_NREC * DP_MAX_JOINTS] = {};
    int32_t no_age[DP_MAX_JOINTS] = {};
    int tick = 0, sensed = 0;
};

}  // namespace

void check_drives(const dp_run_args &a, const Vector &qpos, const Vector &qvel, int controls) {
    for (int j = 0; j < a.drives; j++) {
        const dp_drive &d = a.drive[j];
        auto bad = [](int i, size_t n) { return i < 0 || static_cast<size_t>(i) >= n; };
        if (bad(d.rotor_qpos, qpos.size()) || bad(d.spring_qpos, qpos.size()) || bad(d.rotor_dof, qvel.size()) ||
            bad(d.spring_dof, qvel.size()))
            throw std::invalid_argument("a drive's index is outside the engine's state");
        if (d.control >= controls || d.sensor_delay < 0 || d.sensor_delay > DP_MAX_DELAY || d.inner_steps < 1)
            throw std::invalid_argument("a drive's control index, delay or inner period is out of range");
    }
}

void bind_arm(nb::module_ &m) {
    using Ages = nb::ndarray<nb::numpy, int32_t>;
    auto sized = [](const Arm &l, const Vector &v) {
        if (v.size() != static_cast<size_t>(l.a.drives))
            throw std::invalid_argument("arrays must have one element per joint");
    };
    nb::class_<Arm>(m, "Arm")
        .def("__init__",
             [](Arm *self, Bytes drives, uintptr_t step, double dt, int steps_per_tick, Faults *faults) {
                 const size_t n = drives.size() / sizeof(dp_drive);
                 if (n == 0 || drives.size() % sizeof(dp_drive) || n > DP_MAX_JOINTS || steps_per_tick < 1)
                     throw std::invalid_argument("drive records have the wrong size, or a bad number of steps");
                 if (faults && faults->f.drives != static_cast<int>(n))
                     throw std::invalid_argument("the faults are those of another number of drives");
                 new (self) Arm();
                 std::copy_n(reinterpret_cast<const dp_drive *>(drives.data()), n, self->drive);
                 self->a.step = reinterpret_cast<void (*)(const void *, void *)>(step);
                 self->a.dt = dt;
                 self->a.steps_per_tick = steps_per_tick;
                 self->a.ticks = 1;
                 self->a.drives = static_cast<int>(n);
                 self->a.drive = self->drive;
                 self->a.record = self->record;
                 self->a.faults = faults ? &faults->f : nullptr;
             },
             nb::arg("drives"), nb::arg("step"), nb::arg("dt"), nb::arg("steps_per_tick"), nb::arg("faults").none(),
             nb::keep_alive<1, 6>())
        .def("engine",
             [](Arm &l, uintptr_t model, uintptr_t data, Vector qpos, Vector qvel, Vector qfrc_applied) {
                 check_drives(l.a, qpos, qvel, l.a.drives);
                 if (qfrc_applied.size() != qvel.size())
                     throw std::invalid_argument("the engine's arrays have different sizes");
                 l.a.model = reinterpret_cast<const void *>(model);
                 l.a.data = reinterpret_cast<void *>(data);
                 l.a.qpos = qpos.data();
                 l.a.qvel = qvel.data();
                 l.a.qfrc_applied = qfrc_applied.data();
             },
             nb::arg("model"), nb::arg("data"), nb::arg("qpos").noconvert(), nb::arg("qvel").noconvert(),
             nb::arg("qfrc_applied").noconvert())
        .def("sense",
             [sized](Arm &l, Vector torque, Vector position, Vector velocity) {
                 sized(l, torque), sized(l, position), sized(l, velocity);
                 if (!l.a.data || l.sensed)
                     throw std::invalid_argument("sense and push take turns, after engine");
                 dp_sense(&l.a, l.tick, torque.data(), position.data(), velocity.data());
                 l.sensed = 1;
             },
             nb::arg("torque").noconvert(), nb::arg("position").noconvert(), nb::arg("velocity").noconvert())
        .def("push",
             [sized](Arm &l, Vector torque) {
                 sized(l, torque);
                 if (!l.sensed)
                     throw std::invalid_argument("sense and push take turns");
                 l.sensed = 0;
                 int result;
                 {
                     nb::gil_scoped_release release;
                     result = dp_push(&l.a, l.tick++, torque.data());
                 }
                 return result == DP_RUN_OK;
             },
             nb::arg("torque").noconvert())
        .def_prop_ro("tick", [](const Arm &l) { return l.tick; })
        .def_prop_ro("record",
                     [](Arm &l) {
                         return nb::ndarray<nb::numpy, double>(l.record, {size_t(DP_NREC), size_t(l.a.drives)}, nb::find(l));
                     })
        .def_prop_ro("torque_age", [](Arm &l) {
            return Ages(l.a.faults ? l.a.faults->torque_age : l.no_age, {size_t(l.a.drives)}, nb::find(l));
        })
        .def_prop_ro("encoder_age", [](Arm &l) {
            return Ages(l.a.faults ? l.a.faults->encoder_age : l.no_age, {size_t(l.a.drives)}, nb::find(l));
        });
}

// --- lists of numbers, as other bindings give and take them; per cycle, so without detours over arrays --------

void bind_lists(nb::module_ &m) {
    m.def("take",
          [](nb::list from, Vector to) {
              if (from.size() != to.size())
                  throw std::invalid_argument("list and array must have the same size");
              for (size_t j = 0; j < to.size(); j++)
                  to.data()[j] = nb::cast<double>(from[j]);
          },
          nb::arg("list"), nb::arg("to").noconvert());
    m.def("take_difference",
          [](nb::list from, nb::list less, Vector to) {
              if (from.size() != to.size() || less.size() != to.size())
                  throw std::invalid_argument("lists and array must have the same size");
              for (size_t j = 0; j < to.size(); j++)
                  to.data()[j] = nb::cast<double>(from[j]) - nb::cast<double>(less[j]);
          },
          nb::arg("list"), nb::arg("less"), nb::arg("to").noconvert());
    m.def("bounded",
          [](Vector torque, Vector around, Vector limit, double step) {
              const size_t n = torque.size();
              if (around.size() != n || limit.size() != n)
                  throw std::invalid_argument("arrays must have the same size");
              nb::list out;
              for (size_t j = 0; j < n; j++) {
                  const double u = torque.data()[j], now = around.data()[j];
                  const double x = u - u == 0.0 ? std::clamp(u, now - step, now + step) : now;
                  out.append(std::clamp(x, -limit.data()[j], limit.data()[j]));
              }
              return out;
          },
          nb::arg("torque").noconvert(), nb::arg("around").noconvert(), nb::arg("limit").noconvert(), nb::arg("step"));
}
