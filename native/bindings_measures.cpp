// Python binding of the measures.
#include "bindings.h"

#include "dashpot_measures.h"

#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>

#include <array>
#include <cstring>
#include <optional>
#include <stdexcept>

void bind_measures(nb::module_ &m) {
    using Table = nb::ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
    using Flags = nb::ndarray<const uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
    using Filter = nb::ndarray<const double, nb::shape<2, 5>, nb::c_contig, nb::device::cpu>;
    m.attr("MEASURES") = static_cast<int>(DP_NMEASURE);
    m.def(
        "measure",
        [](std::array<Table, 6> tables, std::optional<Flags> powered, int begin, int event, double period, double slowed,
           double at_rest, int stays, int last, std::optional<Filter> noise, std::optional<Filter> vibration, int window,
           Square out) {
            const size_t ticks = tables[0].shape(0), joints = tables[0].shape(1);
            for (const Table &table : tables)
                if (table.shape(0) != ticks || table.shape(1) != joints)
                    throw std::invalid_argument("tables must have one shape");
            if (ticks < 1 || ticks > 1u << 30 || joints < 1 || (powered && powered->shape(0) != ticks))
                throw std::invalid_argument("there must be ticks and joints, and a flag for every tick");
            if (begin < 0 || event < 0 || static_cast<size_t>(begin) > ticks || static_cast<size_t>(event) > ticks)
                throw std::invalid_argument("begin and event must be ticks");
            if (stays < 1 || last < 0 || window < 0 || 2 * static_cast<size_t>(window) > ticks - begin)
                throw std::invalid_argument("there must be that many ticks");
            if (out.shape(0) != DP_NMEASURE || out.shape(1) != joints)
                throw std::invalid_argument("the result must be (MEASURES, joints)");
            dp_measured a{};
            const double **to[] = {&a.reference, &a.angle, &a.speed, &a.command, &a.in_effect, &a.sample};
            for (int i = 0; i < 6; i++) *to[i] = tables[i].data();
            dp_highpass filters[2];
            const std::optional<Filter> *given[] = {&noise, &vibration};
            for (int i = 0; i < 2; i++)
                if (*given[i]) std::memcpy(filters[i].section, (*given[i])->data(), sizeof filters[i].section);
            a.powered = powered ? powered->data() : nullptr;
            a.ticks = static_cast<int>(ticks), a.joints = static_cast<int>(joints);
            a.begin = begin, a.event = event, a.period = period, a.slowed = slowed, a.at_rest = at_rest;
            a.stays = stays, a.last = last, a.window = window;
            a.noise = noise ? &filters[0] : nullptr, a.vibration = vibration ? &filters[1] : nullptr;
            dp_measure(&a, out.data());
        },
        nb::arg("tables"), nb::arg("powered").none(), nb::arg("begin"), nb::arg("event"), nb::arg("period"),
        nb::arg("slowed"), nb::arg("at_rest"), nb::arg("stays"), nb::arg("last"), nb::arg("noise").none(),
        nb::arg("vibration").none(), nb::arg("window"), nb::arg("out"));
}
