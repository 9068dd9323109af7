// Python bindings of the real-time loop's cycle, of its ring, and of the link to a simulated arm.
#include <time.h>

#include <cerrno>
#include <cmath>
#include <stdexcept>

#include "bindings.h"
#include "dashpot_cycle.h"

namespace {

long long nanoseconds(clockid_t clock) {
    timespec t;
    clock_gettime(clock, &t);
    return t.tv_sec * 1000000000LL + t.tv_nsec;
}

void sleep_until(long long when) {
    const timespec t = {when / 1000000000LL, when % 1000000000LL};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, nullptr) == EINTR) {
    }
}

// One run of the loop: what dp_cycle_step needs, the arrays of the sample it reads, and the clocks.
struct Cycle {
    dp_cycle c{};
    dp_cycle_sample sample{};
    dp_cycle_statistics own{};
    nb::object kept;  // whatever the pointers above point into
    double out[DP_MAX_JOINTS] = {};
    long long period = 0, before = 0, deadline = 0;  // [ns]

    int step(double time) {
        const long long now = nanoseconds(CLOCK_MONOTONIC);
        const double jitter = before ? (now - before - period) * 1e-9 : 0.0;
        before = now;
        sample.time = time;
        const int phase = dp_cycle_step(&c, &sample, nanoseconds(CLOCK_REALTIME), jitter, out);
        const double spent = (nanoseconds(CLOCK_MONOTONIC) - now) * 1e-9;
        c.statistics->step_sum += spent;
        if (spent > c.statistics->step_most)
            c.statistics->step_most = spent;
        return phase;
    }

    // Sleeps until the next multiple of the period; one that has gone by is left out.
    void wait() {
        const long long now = nanoseconds(CLOCK_MONOTONIC);
        deadline = deadline ? deadline + period : now;
        if (now > deadline + period)
            deadline += (now - deadline) / period * period;
        sleep_until(deadline);
    }
};

void make_cycle(Cycle *self, Guard *guard, nb::tuple arrays, Ints order, nb::ndarray<double, nb::ndim<3>, nb::c_contig, nb::device::cpu> reference, long long until,
                double period, int late_cycles, int longest_gap, nb::object ring) {
    const size_t n = static_cast<size_t>(guard->s.n);
    new (self) Cycle();
    const double **values[] = {&self->sample.torque, &self->sample.position, &self->sample.velocity,
                               &self->sample.in_effect};
    const int **ages[] = {&self->sample.torque_age, &self->sample.encoder_age};
    if (nb::len(arrays) != 6 || order.size() != n || reference.shape(0) != 4 || reference.shape(1) < 1 ||
        reference.shape(2) != n)
        throw std::invalid_argument("the sample, the order or the reference has the wrong shape");
    for (size_t i = 0; i < 6; i++) {
        size_t size;
        if (i < 4) {
            Vector a = nb::cast<Vector>(arrays[i], false);
            *values[i] = a.data();
            size = a.size();
        } else {
            Ints a = nb::cast<Ints>(arrays[i], false);
            *ages[i - 4] = a.data();
            size = a.size();
        }
        if (size != n)
            throw std::invalid_argument("an array of the sample has the wrong size");
    }
    dp_cycle &c = self->c;
    c.controller = &guard->core->c;
    c.supervisor = &guard->s;
    c.statistics = &self->own;
    c.reference = reference.data();
    c.rows = static_cast<long long>(reference.shape(1));
    c.until = until;
    c.period = period;
    c.late_cycles = late_cycles;
    c.longest_gap = longest_gap;
    for (size_t j = 0; j < n; j++)
        c.order[j] = order.data()[j];
    self->period = std::llround(period * 1e9);
    if (!ring.is_none()) {
        Bytes memory = nb::cast<Bytes>(ring, false);
        if (memory.size() < dp_ring_size(1))
            throw std::invalid_argument("a ring of less than one row");
        c.ring = reinterpret_cast<dp_ring *>(memory.data());
        c.ring->capacity = (memory.size() - sizeof(dp_ring)) / sizeof(dp_row);
        c.statistics = &c.ring->statistics;
    }
    self->kept = nb::make_tuple(arrays, order, reference, ring);
    if (dp_cycle_init(&c) != 0)
        throw std::invalid_argument("a setting of the loop is out of range");
}

nb::dict statistics_of(const dp_cycle_statistics &t) {
    nb::dict d;
    d["cycles"] = t.cycles;
    d["late"] = t.late;
    d["lost"] = t.lost;
    d["longest"] = t.longest;
    d["same"] = t.same;
    d["jitter_most"] = t.jitter_most;
    d["step_mean"] = t.cycles ? t.step_sum / t.cycles : 0.0;
    d["step_most"] = t.step_most;
    auto *bins = new long long[DP_BINS];
    std::copy(t.jitter, t.jitter + DP_BINS, bins);
    nb::capsule owner(bins, [](void *p) noexcept { delete[] static_cast<long long *>(p); });
    d["jitter"] = nb::ndarray<nb::numpy, long long>(bins, {size_t(DP_BINS)}, owner);
    return d;
}

dp_ring *ring_of(const Bytes &memory) {
    if (memory.size() < dp_ring_size(1))
        throw std::invalid_argument("a ring of less than one row");
    return reinterpret_cast<dp_ring *>(memory.data());
}

}  // namespace

void bind_cycle(nb::module_ &m) {
    m.attr("ROW_SIZE") = sizeof(dp_row);
    m.attr("ROW_COLUMNS") = static_cast<int>(DP_ROW_COLUMNS);
    m.attr("RING_SIZE") = sizeof(dp_ring);
    m.attr("LINK_SAMPLE_SIZE") = sizeof(dp_link_sample);
    m.attr("LINK_COMMAND_SIZE") = sizeof(dp_link_command);
    nb::class_<Cycle>(m, "Cycle")
        .def("__init__", &make_cycle, nb::arg("guard"), nb::arg("sample"), nb::arg("order").noconvert(),
             nb::arg("reference").noconvert(), nb::arg("until"), nb::arg("period"), nb::arg("late_cycles"),
             nb::arg("longest_gap"), nb::arg("ring").none(), nb::keep_alive<1, 2>())
        .def("step", &Cycle::step, nb::arg("time"))
        .def("wait", &Cycle::wait, nb::call_guard<nb::gil_scoped_release>())
        .def_prop_ro("out",
                     [](Cycle &s) {
                         return nb::ndarray<nb::numpy, double>(s.out, {size_t(s.c.supervisor->n)}, nb::find(s));
                     })
        .def_prop_ro("statistics", [](const Cycle &s) { return statistics_of(*s.c.statistics); })
        .def_prop_ro("behind",
                     [](const Cycle &s) {
                         return s.c.ring ? s.c.ring->head - __atomic_load_n(&s.c.ring->read, __ATOMIC_ACQUIRE) : 0ULL;
                     })
        .def("close",
             [](Cycle &s) {
                 if (s.c.ring)
                     __atomic_store_n(&s.c.ring->closed, 1, __ATOMIC_RELEASE);
             })
        // For benchmarks: seconds are measured by the caller; the robot's clock goes on by a period each time.
        .def("step_many", [](Cycle &s, int count) {
            nb::gil_scoped_release release;
            for (int i = 0; i < count; i++) {
                s.sample.time = s.c.begun ? s.c.last + s.c.period : 0.0;
                dp_cycle_step(&s.c, &s.sample, i, 0.0, s.out);
            }
        });
    m.def("sleep_until", &sleep_until, nb::arg("nanoseconds"), nb::call_guard<nb::gil_scoped_release>());
    m.def("ring_drain",
          [](Bytes memory, Bytes out, unsigned long long next) {
              unsigned long long missed = 0;
              const int count = dp_ring_drain(ring_of(memory), reinterpret_cast<dp_row *>(out.data()),
                                              static_cast<int>(out.size() / sizeof(dp_row)), &next, &missed);
              return nb::make_tuple(count, next, missed);
          },
          nb::arg("ring").noconvert(), nb::arg("out").noconvert(), nb::arg("next"));
    m.def("ring_state", [](Bytes memory) {
        const dp_ring *r = ring_of(memory);
        const long long decisions = __atomic_load_n(&r->decisions, __ATOMIC_ACQUIRE);
        nb::list rows;
        for (long long i = decisions > DP_LOG ? decisions - DP_LOG : 0; i < decisions; i++) {
            const dp_decision &d = r->log[i % DP_LOG];
            rows.append(nb::make_tuple(d.tick, d.joint, d.from, d.to, d.why, d.value, d.threshold));
        }
        return nb::make_tuple(__atomic_load_n(&r->closed, __ATOMIC_ACQUIRE) != 0, decisions, rows,
                              statistics_of(r->statistics));
    });
    nb::class_<Link>(m, "Link")
        .def("__init__",
             [](Link *self, int socket, bool realtime, bool listening, double period, double answer, int watchdog,
                int after, int quiet) {
                 if (!(period > 0) || !(answer > 0 && answer <= 1) || watchdog < 1 || after < 0)
                     throw std::invalid_argument("a setting of the link is out of range");
                 new (self) Link();
                 self->l.socket = socket;
                 self->l.realtime = realtime;
                 self->l.listening = listening;
                 self->l.period = period;
                 self->l.answer = answer;
                 self->l.watchdog = watchdog;
                 self->l.after = after;
                 self->l.quiet = quiet;
                 dp_link_begin(&self->l);
             },
             nb::arg("socket"), nb::arg("realtime"), nb::arg("listening"), nb::arg("period"), nb::arg("answer"),
             nb::arg("watchdog"), nb::arg("after"), nb::arg("quiet"))
        .def_prop_ro("started", [](const Link &s) { return s.l.started != 0; })
        .def_prop_ro("stopped", [](const Link &s) { return s.l.stopped != 0; })
        .def_prop_ro("gone", [](const Link &s) { return s.l.gone != 0; })
        .def_prop_ro("tripped_at", [](const Link &s) { return s.l.tripped_at; })
        .def_prop_ro("end", [](const Link &s) { return s.l.end != 0; });
}
