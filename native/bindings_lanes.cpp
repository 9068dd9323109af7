// Python bindings of the vectorised arm.
#include <algorithm>
#include <stdexcept>
#include <vector>

#include "bindings.h"
#include "dashpot_lanes.h"

namespace {

// A scenario that is to run; the arrays and objects it points to are kept alive by the Python object.
struct Scenario {
    dp_lane lane{};
    size_t links = 0;
};

const dp_tree &tree_of(const Bytes &raw) {
    if (raw.size() != sizeof(dp_tree))
        throw std::invalid_argument("the tree has the wrong size");
    const dp_tree &t = *reinterpret_cast<const dp_tree *>(raw.data());
    if (t.links < 1 || t.links > DP_MAX_LINKS)
        throw std::invalid_argument("the tree has too many links, or none");
    for (int i = 0; i < t.links; i++)
        if (t.parent[i] < -1 || t.parent[i] >= i || t.drive[i] >= DP_MAX_JOINTS)
            throw std::invalid_argument("the tree's links must follow their parents, and their drives exist");
    return t;
}

const dp_lanes &lanes_of(int width) {
    for (int i = 0; const dp_lanes *lanes = dp_lanes_at(i); i++)
        if (lanes->width == width)
            return *lanes;
    throw std::invalid_argument("this machine has no registers of that width");
}

// The last group may be a small one, and a wide step costs more than a narrow one.
const dp_lanes &narrowest(int count) {
    int i = 0;
    while (dp_lanes_at(i + 1) && dp_lanes_at(i)->width < count)
        i++;
    return *dp_lanes_at(i);
}

void run_lanes(Bytes tree, nb::list scenarios, int width) {
    const dp_tree &t = tree_of(tree);
    lanes_of(width);
    std::vector<Scenario *> all;
    for (nb::handle h : scenarios) {
        Scenario *s = nb::cast<Scenario *>(h);
        const dp_run_args &a = s->lane.a, &first = all.empty() ? a : all[0]->lane.a;
        if (s->links != static_cast<size_t>(t.links) || a.drives != first.drives || a.dt != first.dt ||
            a.steps_per_tick != first.steps_per_tick)
            throw std::invalid_argument("scenarios that run together need one arm and one time step");
        for (int j = 0; j < a.drives; j++)
            if (std::count(t.drive, t.drive + t.links, j) != 1)
                throw std::invalid_argument("every drive must move one link");
        for (int i = 0; i < t.links; i++)
            if (t.drive[i] >= a.drives)
                throw std::invalid_argument("a link's drive does not exist");
        if (std::count(all.begin(), all.end(), s))
            throw std::invalid_argument("a scenario can run only once at a time");
        all.push_back(s);
    }
    nb::gil_scoped_release release;
    std::vector<dp_lane> group;
    for (size_t first = 0; first < all.size(); first += width) {
        const size_t count = std::min(all.size() - first, static_cast<size_t>(width));
        group.clear();
        for (size_t l = 0; l < count; l++)
            group.push_back(all[first + l]->lane);
        narrowest(static_cast<int>(count)).run(&t, group.data(), static_cast<int>(count));
        for (size_t l = 0; l < count; l++)
            all[first + l]->lane.a.diverged_tick = group[l].a.diverged_tick;
    }
}

}  // namespace

void bind_lanes(nb::module_ &m) {
    using Cube = nb::ndarray<double, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
    m.attr("TREE_SIZE") = sizeof(dp_tree);
    m.attr("MAX_LINKS") = static_cast<int>(DP_MAX_LINKS);
    nb::dict widths;
    for (int i = 0; const dp_lanes *lanes = dp_lanes_at(i); i++)
        widths[nb::int_(lanes->width)] = lanes->name;
    m.attr("LANES") = widths;
    nb::class_<Scenario>(m, "Lane")
        .def("__init__",
             [](Scenario *self, Core *core, Bytes drives, Bytes events, Vector qpos, Vector qvel, double dt, int steps_per_tick,
                int ticks, nb::object reference, nb::object external, nb::object record, nb::object status, Faults *faults,
                Guard *guard, Square rotors, Ints load_ticks, Cube loads, nb::object bare) {
                 new (self) Scenario();
                 dp_lane &lane = self->lane;
                 fill(lane.a, core, drives, events, qpos, qvel, dt, steps_per_tick, ticks, reference, external, record, status,
                      faults, guard);
                 lane.a.last = ticks;
                 lane.c = core ? &core->c : nullptr;
                 lane.qpos = qpos.data();
                 lane.qvel = qvel.data();
                 self->links = loads.shape(1);
                 if (rotors.shape(0) != static_cast<size_t>(lane.a.drives) || rotors.shape(1) != 2 || loads.shape(0) < 1 ||
                     loads.shape(2) != DP_NBODY || load_ticks.size() != loads.shape(0) || self->links > DP_MAX_LINKS)
                     throw std::invalid_argument("rotors or loads have the wrong shape");
                 lane.rotor = rotors.data();
                 lane.loads = static_cast<int>(loads.shape(0));
                 lane.load_tick = load_ticks.data();
                 lane.load = loads.data();
                 if (!bare.is_none()) {
                     Square b = nb::cast<Square>(bare, false);
                     if (b.shape(0) != self->links || b.shape(1) != DP_NBODY)
                         throw std::invalid_argument("bare has the wrong shape");
                     lane.bare = b.data();
                 }
             },
             nb::arg("core").none(), nb::arg("drives").noconvert(), nb::arg("events").noconvert(), nb::arg("qpos").noconvert(),
             nb::arg("qvel").noconvert(), nb::arg("dt"), nb::arg("steps_per_tick"), nb::arg("ticks"), nb::arg("reference").none(),
             nb::arg("external").none(), nb::arg("record").none(), nb::arg("status").none(), nb::arg("faults").none(),
             nb::arg("guard").none(), nb::arg("rotors").noconvert(), nb::arg("load_ticks").noconvert(),
             nb::arg("loads").noconvert(), nb::arg("bare").none(), nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>(),
             nb::keep_alive<1, 4>(), nb::keep_alive<1, 5>(), nb::keep_alive<1, 6>(), nb::keep_alive<1, 10>(),
             nb::keep_alive<1, 11>(), nb::keep_alive<1, 12>(), nb::keep_alive<1, 13>(), nb::keep_alive<1, 14>(),
             nb::keep_alive<1, 15>(), nb::keep_alive<1, 16>(), nb::keep_alive<1, 17>(), nb::keep_alive<1, 18>(),
             nb::keep_alive<1, 19>())
        .def_prop_ro("diverged_tick", [](const Scenario &s) { return s.lane.a.diverged_tick; });
    m.def("run_lanes", &run_lanes, nb::arg("tree"), nb::arg("scenarios"), nb::arg("width"));
    m.def("forward_dynamics",
          [](Bytes tree, Cube body, Square q, Square qd, Square torque, Square qdd, nb::object mass, nb::object bias, int width) {
              const dp_tree &t = tree_of(tree);
              const dp_lanes &lanes = lanes_of(width);
              const size_t count = q.shape(0), n = static_cast<size_t>(t.links);
              auto shaped = [&](const Square &a) { return a.shape(0) == count && a.shape(1) == n; };
              if (body.shape(0) != count || body.shape(1) != n || body.shape(2) != DP_NBODY || !shaped(q) || !shaped(qd) ||
                  !shaped(torque) || !shaped(qdd))
                  throw std::invalid_argument("shapes do not fit together");
              double *H = nullptr, *b = nullptr;
              if (!mass.is_none()) {
                  Cube c = nb::cast<Cube>(mass, false);
                  if (c.shape(0) != count || c.shape(1) != n || c.shape(2) != n)
                      throw std::invalid_argument("mass has the wrong shape");
                  H = c.data();
              }
              if (!bias.is_none()) {
                  Square s = nb::cast<Square>(bias, false);
                  if (!shaped(s))
                      throw std::invalid_argument("bias has the wrong shape");
                  b = s.data();
              }
              nb::gil_scoped_release release;
              lanes.forward(&t, body.data(), q.data(), qd.data(), torque.data(), qdd.data(), H, b, static_cast<int>(count));
          },
          nb::arg("tree"), nb::arg("body"), nb::arg("q"), nb::arg("qd"), nb::arg("torque"), nb::arg("qdd").noconvert(),
          nb::arg("mass").none(), nb::arg("bias").none(), nb::arg("width"));
    m.def("lane_functions",
          [](Vector x, Vector sine, Vector cosine, Vector decay, int width) {
              if (sine.size() != x.size() || cosine.size() != x.size() || decay.size() != x.size())
                  throw std::invalid_argument("arrays must have the same size");
              lanes_of(width).functions(x.data(), sine.data(), cosine.data(), decay.data(), static_cast<int>(x.size()));
          },
          nb::arg("x"), nb::arg("sine").noconvert(), nb::arg("cosine").noconvert(), nb::arg("decay").noconvert(),
          nb::arg("width"));
}
