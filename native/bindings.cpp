// Python bindings of the controller core and the closed-loop runner.
#include <stdexcept>
#include <string>
#include <vector>

#include "bindings.h"
#include "dashpot_faults.h"
#include "dashpot_gravity.h"
#include "dashpot_runner.h"
#include "dashpot_stops.h"

static double *optional(nb::object o, size_t size, const char *name) {
    if (o.is_none())
        return nullptr;
    Array a = nb::cast<Array>(o, false);
    if (a.size() != size)
        throw std::invalid_argument(std::string(name) + " has the wrong size");
    return a.data();
}

void fill(dp_run_args &a, Core *core, Bytes drives, Bytes events, Vector qpos, Vector qvel, double dt, int steps_per_tick,
          int ticks, nb::object reference, nb::object external, nb::object record, nb::object status, Faults *faults,
          Guard *guard) {
    if (drives.size() == 0 || drives.size() % sizeof(dp_drive) || events.size() % sizeof(dp_event))
        throw std::invalid_argument("drive or event records have the wrong size");
    a.qpos = qpos.data();
    a.qvel = qvel.data();
    a.dt = dt;
    a.steps_per_tick = steps_per_tick;
    a.ticks = ticks;
    a.drives = static_cast<int>(drives.size() / sizeof(dp_drive));
    a.events = static_cast<int>(events.size() / sizeof(dp_event));
    a.drive = reinterpret_cast<dp_drive *>(drives.data());
    a.event = reinterpret_cast<const dp_event *>(events.data());
    if (a.drives > DP_MAX_JOINTS || ticks < 0 || steps_per_tick < 1)
        throw std::invalid_argument("too many drives, or a bad number of ticks or steps");
    if (faults && faults->f.drives != a.drives)
        throw std::invalid_argument("the faults are those of another number of drives");
    a.faults = faults ? &faults->f : nullptr;
    if (guard) {
        if (!faults || guard->core != core)
            throw std::invalid_argument("a supervisor needs the controller it was made for, and a script of faults");
        a.supervise = dp_supervise;
        a.supervisor = &guard->s;
        a.apply_brake = &guard->s.apply_brake;
        a.state = &guard->s.state;
        a.supervisor_gravity = guard->s.gravity;
    }
    check_drives(a, qpos, qvel, core ? core->c.n : 0);
    for (int i = 0; i < a.events; i++)
        if (!core || a.event[i].joint < 0 || a.event[i].joint >= core->c.n)
            throw std::invalid_argument("an event names a joint that is not controlled");
    const size_t cells = static_cast<size_t>(ticks) * a.drives;
    a.reference = optional(reference, 4 * cells, "reference");
    a.external = optional(external, cells, "external");
    a.record = optional(record, DP_NREC * cells, "record");
    if (!status.is_none()) {
        Ints s = nb::cast<Ints>(status, false);
        if (s.size() != static_cast<size_t>(ticks))
            throw std::invalid_argument("status has the wrong size");
        a.status = s.data();
    }
}

namespace {

// The robot's own gravity compensation in one run; the engine's model and data are kept alive by the caller.
struct Gravity {
    dp_gravity g{};
    std::vector<double> all;
};

const dp_block *blocks_of(const Bytes &raw, int &n) {
    if (raw.size() == 0 || raw.size() % sizeof(dp_block) != 0)
        throw std::invalid_argument("coefficient blocks have the wrong size");
    n = static_cast<int>(raw.size() / sizeof(dp_block));
    return reinterpret_cast<const dp_block *>(raw.data());
}

int check_joint(const Core &core, int joint) {
    if (joint < 0 || joint >= core.c.n)
        throw nb::index_error(("joint index " + std::to_string(joint) + " is not in 0.." +
                               std::to_string(core.c.n - 1)).c_str());
    return joint;
}

nb::tuple run(Core *core, Bytes drives, Bytes events, uintptr_t step, uintptr_t model, uintptr_t data, Vector qpos,
              Vector qvel, Vector qfrc_applied, double dt, int steps_per_tick, int ticks, nb::object reference,
              nb::object external, nb::object record, nb::object status, Faults *faults, int first, int last,
              Guard *guard, Link *link, Gravity *gravity, int origin) {
    dp_run_args a{};
    a.first = first;
    a.origin = origin;
    a.last = last < 0 ? origin + ticks : last;
    if (origin < 0 || first < origin || static_cast<long>(a.last) > static_cast<long>(origin) + ticks)
        throw std::invalid_argument("a bad number of ticks");
    fill(a, core, drives, events, qpos, qvel, dt, steps_per_tick, ticks, reference, external, record, status, faults, guard);
    if (qfrc_applied.size() != qvel.size())
        throw std::invalid_argument("a drive's index is outside the engine's state");
    a.step = reinterpret_cast<void (*)(const void *, void *)>(step);
    a.model = reinterpret_cast<const void *>(model);
    a.data = reinterpret_cast<void *>(data);
    a.qfrc_applied = qfrc_applied.data();
    if (link) {
        if (!faults || guard || !core)
            throw std::invalid_argument("a link needs a controller, a script of faults, and no supervisor");
        a.supervise = dp_link_exchange;
        a.supervisor = reinterpret_cast<dp_supervisor *>(&link->l);
        a.apply_brake = &link->l.apply_brake;
        a.state = &link->l.state;
        a.end = &link->l.end;
        link->l.tick = &a.tick;
    }
    if (gravity) {
        if (gravity->g.n != a.drives)
            throw std::invalid_argument("the gravity compensation is that of another number of drives");
        a.gravity = dp_gravity_torque;
        a.gravity_of = &gravity->g;
    }
    int result;
    {
        nb::gil_scoped_release release;
        result = dp_run(core ? &core->c : nullptr, &a);
    }
    return nb::make_tuple(result, a.diverged_tick);
}

void stops(Bytes blocks, Square slip, Square stick, Vector start, Vector sample, int rotor, int held, int link, int spring,
           int slips, int mean, int substeps, int late, double coulomb, double damper, double torque_gain, double speed,
           int window, double still, Square speeds, Square commands) {
    int count = 0;
    const dp_block *first = blocks_of(blocks, count);
    const size_t n = start.size(), k = static_cast<size_t>(count);
    auto shaped = [](const Square &s, size_t rows, size_t columns) { return s.shape(0) == rows && s.shape(1) == columns; };
    if (!shaped(slip, n, n) || !shaped(stick, n, n) || sample.size() != n || speeds.shape(0) != k ||
        !shaped(commands, k, speeds.shape(1)))
        throw std::invalid_argument("shapes do not fit together");
    dp_stop_args a{static_cast<int>(n), slip.data(), stick.data(), start.data(), sample.data(), rotor, held, link, spring, slips,
                   mean, substeps, static_cast<int>(speeds.shape(1)), late, coulomb, damper, torque_gain, speed, window, still};
    int result;
    {
        nb::gil_scoped_release release;
        result = dp_stops(first, count, &a, speeds.data(), commands.data());
    }
    if (result != 0)
        throw std::invalid_argument("a number or a block is out of range");
}

// --- supervisor -------------------------------------------------------------------------------------------

void bind_supervisor(nb::module_ &m) {
    m.attr("WATCH_SIZE") = sizeof(dp_watch);
    m.attr("RULES_SIZE") = sizeof(dp_rules);
    m.attr("REASONS") = static_cast<int>(DP_NWHY);
    m.attr("LOG") = static_cast<int>(DP_LOG);
    m.attr("HISTORY") = static_cast<int>(DP_HISTORY);
    m.def("next_state", &dp_next, nb::arg("state"), nb::arg("events"));
    using Ages = nb::ndarray<nb::numpy, int32_t>;
    nb::class_<Guard>(m, "Guard")
        .def("__init__",
             [](Guard *self, Core *core, Bytes rules, Bytes watch) {
                 if (rules.size() != sizeof(dp_rules) || watch.size() != sizeof(dp_watch) * size_t(core->c.n))
                     throw std::invalid_argument("supervisor records have the wrong size");
                 new (self) Guard();
                 self->core = core;
                 if (dp_supervisor_init(&self->s, reinterpret_cast<const dp_rules *>(rules.data()),
                                        reinterpret_cast<const dp_watch *>(watch.data()), core->c.n) != 0)
                     throw std::invalid_argument("a number of the supervisor is out of range");
             },
             nb::arg("core"), nb::arg("rules"), nb::arg("watch"), nb::keep_alive<1, 2>())
        .def_prop_ro("gravity",
                     [](Guard &g) {
                         return nb::ndarray<nb::numpy, double>(g.s.gravity, {size_t(g.s.n)}, nb::find(g));
                     })
        .def_prop_ro("torque_age", [](Guard &g) { return Ages(g.torque_age, {size_t(g.s.n)}, nb::find(g)); })
        .def_prop_ro("encoder_age", [](Guard &g) { return Ages(g.encoder_age, {size_t(g.s.n)}, nb::find(g)); })
        .def_prop_ro("state", [](const Guard &g) { return g.s.state; })
        .def_prop_ro("apply_brake", [](const Guard &g) { return g.s.apply_brake != 0; })
        .def_prop_ro("stopped", [](const Guard &g) { return g.s.stopped != 0; })
        .def_prop_ro("tick", [](const Guard &g) { return g.s.tick; })
        .def_prop_ro("decisions", [](const Guard &g) { return g.s.decisions; })
        .def("step",
             [](Guard &g, Vector out) {
                 if (out.size() != static_cast<size_t>(g.s.n))
                     throw std::invalid_argument("out must have one element per joint");
                 return dp_supervise(&g.s, &g.core->c, g.core->in, g.torque_age, g.encoder_age, out.data());
             },
             nb::arg("out").noconvert())
        .def("stop", [](Guard &g, int why) { dp_supervisor_stop(&g.s, why); }, nb::arg("why"))
        .def("park", [](Guard &g) { dp_supervisor_park(&g.s); })
        .def("reset", [](Guard &g) { dp_supervisor_reset(&g.s, &g.core->c); })
        .def("log",
             [](const Guard &g) {
                 nb::list rows;
                 for (long long i = g.s.decisions > DP_LOG ? g.s.decisions - DP_LOG : 0; i < g.s.decisions; i++) {
                     const dp_decision &d = g.s.log[i % DP_LOG];
                     rows.append(nb::make_tuple(d.tick, d.joint, d.from, d.to, d.why, d.value, d.threshold));
                 }
                 return rows;
             })
        .def("joint_state",
             [](const Guard &g, int j) {
                 const dp_joint_watch &o = g.s.joint[check_joint(*g.core, j)];
                 return nb::make_tuple(o.residual, o.bound + g.s.watch[j].noise, o.speed, o.bias,
                                       !o.encoder_lost, !o.torque_lost, o.cycles);
             })
        // For benchmarks, as step_many.
        .def("step_many", [](Guard &g, int count) {
            nb::gil_scoped_release release;
            for (int i = 0; i < count; i++)
                dp_supervise(&g.s, &g.core->c, g.core->in, g.torque_age, g.encoder_age, g.core->out);
        });
}

// Text of the controller and the supervisor, as compiled here; `dashpot export` writes it out.
const char *const SOURCES[][2] = {
#include "exported_sources.inc"
};

}  // namespace

NB_MODULE(_native, m) {
    // Controllers kept in caches or module globals live until the interpreter ends; that is no leak.
    nb::set_leak_warnings(false);
    m.attr("BLOCK_SIZE") = sizeof(dp_block);
    m.attr("DRIVE_SIZE") = sizeof(dp_drive);
    m.attr("EVENT_SIZE") = sizeof(dp_event);
    m.attr("MAX_JOINTS") = static_cast<int>(DP_MAX_JOINTS);
    m.attr("MAX_LATENCY") = static_cast<int>(DP_MAX_LATENCY);
    m.attr("MAX_DELAY") = static_cast<int>(DP_MAX_DELAY);
    m.attr("FAULT_SIZE") = sizeof(dp_fault);
    m.attr("MAX_FAULTS") = static_cast<int>(DP_MAX_FAULTS);
    m.attr("MAX_LATE") = static_cast<int>(DP_MAX_LATE);

    nb::class_<Core>(m, "Core")
        .def("__init__",
             [](Core *self, Bytes raw) {
                 int n = 0;
                 const dp_block *blocks = blocks_of(raw, n);
                 new (self) Core();
                 if (dp_init(&self->c, blocks, n) != 0)
                     throw std::invalid_argument("number of joints, states, latency, blend or a limit out of range");
             })
        .def_prop_ro("n", [](const Core &s) { return s.c.n; })
        .def_prop_ro("inputs",
                     [](Core &s) {
                         return nb::ndarray<nb::numpy, double>(s.in, {size_t(DP_NIN), size_t(s.c.n)}, nb::find(s));
                     })
        .def("step",
             [](Core &s, Vector out) {
                 if (out.size() != static_cast<size_t>(s.c.n))
                     throw std::invalid_argument("out must have one element per joint");
                 return dp_step(&s.c, s.in, out.data());
             },
             nb::arg("out").noconvert())  // a converted copy would swallow the torques
        .def("step",
             [](Core &s, Array in, Vector out) {
                 if (in.ndim() != 2 || in.shape(0) != DP_NIN || in.shape(1) != static_cast<size_t>(s.c.n) || out.size() != static_cast<size_t>(s.c.n))
                     throw std::invalid_argument("inputs must have shape (7, n) and out (n,)");
                 return dp_step(&s.c, in.data(), out.data());
             },
             nb::arg("inputs"), nb::arg("out").noconvert())
        .def("issue",
             [](Core &s, Vector torque, Vector out) {
                 if (torque.size() != static_cast<size_t>(s.c.n) || out.size() != static_cast<size_t>(s.c.n))
                     throw std::invalid_argument("torque and out must have one element per joint");
                 return dp_issue(&s.c, torque.data(), out.data());
             },
             nb::arg("torque"), nb::arg("out").noconvert())
        .def("reset", [](Core &s) { dp_reset(&s.c); })
        .def("set_mode", [](Core &s, int j, int mode) { dp_set_mode(&s.c, check_joint(s, j), mode); })
        .def("set_position_loop", [](Core &s, int j, bool on) { dp_set_position_loop(&s.c, check_joint(s, j), on); })
        .def("warm_start", [](Core &s, int j, double v) { dp_warm_start(&s.c, check_joint(s, j), v); })
        .def("preset",
             [](Core &s, int j, Vector x, double torque) {
                 if (x.size() != static_cast<size_t>(DP_NX))
                     throw std::invalid_argument("x must have one element per state of a block");
                 dp_preset(&s.c, check_joint(s, j), x.data(), torque);
             })
        .def("joint_state",
             [](const Core &s, int j) {
                 const dp_state &t = s.c.state[check_joint(s, j)];
                 return nb::make_tuple(t.mode, t.position_loop != 0, t.command, t.in_effect, t.status,
                                       nb::make_tuple(t.x[0], t.x[1], t.x[2], t.x[3]));
             });

    nb::class_<Faults>(m, "Faults")
        .def("__init__",
             [](Faults *self, Bytes script, Square of, double brake_delay) {
                 if (script.size() % sizeof(dp_fault) || of.shape(1) * sizeof(double) != sizeof(dp_fault_drive))
                     throw std::invalid_argument("fault or drive records have the wrong size");
                 new (self) Faults();
                 if (dp_faults_init(&self->f, reinterpret_cast<const dp_fault *>(script.data()),
                                    static_cast<int>(script.size() / sizeof(dp_fault)),
                                    reinterpret_cast<const dp_fault_drive *>(of.data()),
                                    static_cast<int>(of.shape(0)), brake_delay) != 0)
                     throw std::invalid_argument("a number of faults or drives, a kind or a value is out of range");
             },
             nb::arg("script"), nb::arg("drives"), nb::arg("brake_delay"))
        .def_prop_rw("apply_brake", [](const Faults &s) { return s.f.apply_brake != 0; },
                     [](Faults &s, bool on) { s.f.apply_brake = on; })
        .def_prop_rw("stopped_at", [](const Faults &s) { return s.f.stopped_at; },
                     [](Faults &s, int tick) { s.f.stopped_at = tick; })
        .def("put",
             [](Faults &s, int i, Bytes fault) {
                 if (fault.size() != sizeof(dp_fault) ||
                     dp_faults_put(&s.f, i, reinterpret_cast<const dp_fault *>(fault.data())) != 0)
                     throw std::invalid_argument("the place or the fault is out of range");
             },
             nb::arg("place"), nb::arg("fault"))
        .def_prop_ro("ages", [](const Faults &s) {
            nb::list ages;
            for (int j = 0; j < s.f.drives; j++)
                ages.append(nb::make_tuple(s.f.torque_age[j], s.f.encoder_age[j]));
            return ages;
        });

    nb::class_<Gravity>(m, "Gravity")
        .def("__init__",
             [](Gravity *self, uintptr_t kinematics, uintptr_t com, uintptr_t rne, uintptr_t model, uintptr_t data,
                Vector qpos, Ints rotor_qpos, Ints rotor_dof, int dof) {
                 const size_t n = rotor_qpos.size();
                 if (n < 1 || n > DP_MAX_JOINTS || rotor_dof.size() != n || dof < 1)
                     throw std::invalid_argument("the joints do not fit together");
                 new (self) Gravity();
                 dp_gravity &g = self->g;
                 g.kinematics = reinterpret_cast<void (*)(const void *, void *)>(kinematics);
                 g.com = reinterpret_cast<void (*)(const void *, void *)>(com);
                 g.rne = reinterpret_cast<void (*)(const void *, void *, int, double *)>(rne);
                 g.model = reinterpret_cast<const void *>(model);
                 g.data = reinterpret_cast<void *>(data);
                 g.qpos = qpos.data();
                 g.n = static_cast<int>(n);
                 self->all.resize(static_cast<size_t>(dof));
                 g.all = self->all.data();
                 for (size_t j = 0; j < n; j++) {
                     g.qpos_index[j] = rotor_qpos.data()[j];
                     g.dof_index[j] = rotor_dof.data()[j];
                     if (g.qpos_index[j] < 0 || size_t(g.qpos_index[j]) >= qpos.size() || g.dof_index[j] < 0 ||
                         g.dof_index[j] >= dof)
                         throw std::invalid_argument("a joint's index is outside the engine's state");
                 }
             },
             nb::arg("kinematics"), nb::arg("com"), nb::arg("rne"), nb::arg("model"), nb::arg("data"),
             nb::arg("qpos").noconvert(), nb::arg("rotor_qpos"), nb::arg("rotor_dof"), nb::arg("dof"))
        .def("torque", [](Gravity &s, Vector position, Vector out) {
            if (position.size() != size_t(s.g.n) || out.size() != size_t(s.g.n))
                throw std::invalid_argument("position and out must have one element per joint");
            dp_gravity_torque(&s.g, position.data(), out.data());
        }, nb::arg("position"), nb::arg("out").noconvert());

    m.def("run", &run, nb::arg("core").none(), nb::arg("drives").noconvert(), nb::arg("events"), nb::arg("step"), nb::arg("model"),
          nb::arg("data"), nb::arg("qpos").noconvert(), nb::arg("qvel").noconvert(), nb::arg("qfrc_applied").noconvert(), nb::arg("dt"),
          nb::arg("steps_per_tick"), nb::arg("ticks"), nb::arg("reference").none(), nb::arg("external").none(),
          nb::arg("record").none(), nb::arg("status").none(), nb::arg("faults").none() = nb::none(), nb::arg("first") = 0,
          nb::arg("last") = -1, nb::arg("guard").none() = nb::none(), nb::arg("link").none() = nb::none(),
          nb::arg("gravity").none() = nb::none(), nb::arg("origin") = 0);

    m.def("stops", &stops, nb::arg("blocks"), nb::arg("slip").noconvert(), nb::arg("stick").noconvert(), nb::arg("start"),
          nb::arg("sample"), nb::arg("rotor"), nb::arg("held"), nb::arg("link"), nb::arg("spring"), nb::arg("slips"),
          nb::arg("mean"), nb::arg("substeps"), nb::arg("late"), nb::arg("coulomb"), nb::arg("damper"),
          nb::arg("torque_gain"), nb::arg("speed"), nb::arg("window"), nb::arg("still"),
          nb::arg("speeds").noconvert(), nb::arg("commands").noconvert());

    bind_arm(m);
    bind_lists(m);
    bind_supervisor(m);
    bind_cycle(m);
    bind_lanes(m);
    bind_measures(m);

    nb::dict sources;
    for (const auto &source : SOURCES)
        sources[source[0]] = source[1];
    m.attr("SOURCES") = sources;

    // For benchmarks: seconds are measured by the caller; no Python between the steps.
    m.def("step_many", [](Core &s, int count) {
        nb::gil_scoped_release release;
        for (int i = 0; i < count; i++)
            dp_step(&s.c, s.in, s.out);
    });
}
