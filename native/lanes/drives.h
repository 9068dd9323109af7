// The drives of all lanes between two ticks: dp_run's `actuate`, `observe` and `dp_faults_forces`, in the same order of
// operations. What the code at a tick reads and writes travels to and from the scenarios' own records there.
#include "dashpot_faults.h"
#include "dashpot_lanes.h"
#include "vector.h"

namespace {

struct Drive {
    // As in dp_drive.
    V stiffness, damping, half_gap, hysteresis, hysteresis_stiffness, coulomb, stribeck, stribeck_rate;
    V presliding_stiffness, presliding_damping, stop_lower, stop_upper, stop_stiffness, stop_damping;
    V torque_limit, actuator_gain, inner_gain, inner_pole, motor_limit, filter_a[4], filter_b[2];
    V servo_kp, servo_kd, servo_ki, servo_limit, filtered, servo;  // the last two: 1 or 0
    V friction_z, tau, filter_x[2], sum, motor, measured_tau, friction, asked, gravity;
    V hysteresis_z, integral, inner_torque, inner_correction;
    // Of this step.
    V external, reference, reference_rate;
    // Faults: short circuit and mechanical brake.
    V short_damping, short_corner, most_damping, brake, closing, brake_z;
    // Elements that no lane has are not computed.
    bool has_gap, has_hysteresis, has_friction, has_stribeck, has_delay, has_filter, has_inner, has_servo;
    bool has_short, has_brake;
    int delay[W], inner_steps[W];
};

DP_INLINE V slip(V &z, V delta, V stiffness, V limit) { return z = clamp(z + stiffness * delta, limit); }

// Torques of the coming step, on the rotor and on the link; all but the spring's and damper's own.
DP_INLINE void actuate(Drive &d, V theta, V e, V w, V de, double ahead, double dt, long step, V &on_rotor, V &on_link) {
    V torque = d.motor;
    if (d.has_servo) {
        const Mask by = d.servo > 0.0;
        const V error = d.reference + ahead * d.reference_rate - theta;
        const V u = d.servo_kp * error + d.servo_kd * (d.reference_rate - w) + d.integral;
        const V held = clamp(u, d.servo_limit);
        d.integral = pick(by & (held == u), d.integral + d.servo_ki * error * dt, d.integral);
        torque = pick(by, held, torque);
    }
    torque = clamp(torque, d.torque_limit);
    d.asked = torque;
    torque = clamp(torque + d.gravity, d.motor_limit);
    if (d.has_inner) {
        const Mask has = d.inner_gain > 0.0;
        d.inner_torque = pick(has, d.tau + d.inner_pole * (d.inner_torque - d.tau), d.inner_torque);
        for (int l = 0; l < W; l++)
            if (d.inner_gain[l] > 0.0 && step % d.inner_steps[l] == 0)
                d.inner_correction[l] = d.inner_gain[l] * (torque[l] - d.inner_torque[l]);
        torque = pick(has, torque + d.inner_correction, torque);
    }
    V spring = V{};
    if (d.has_gap) spring = pick(d.half_gap > 0.0, d.stiffness * clamp(e, d.half_gap), spring);
    if (d.has_hysteresis) spring = pick(d.hysteresis > 0.0, spring - d.hysteresis_z, spring);
    V link = d.external;
    const V angle = theta + e;
    const Mask above = angle > d.stop_upper, below = angle < d.stop_lower;
    if (any(above | below)) {
        const V depth = pick(above, angle - d.stop_upper, angle - d.stop_lower);
        const V push = d.stop_stiffness * depth + d.stop_damping * (w + de);
        link = pick((above | below) & (push * depth > 0.0), link - push, link);
    }
    on_rotor = d.actuator_gain * torque - d.friction - spring;
    on_link = spring + link;
    if (d.has_short) {
        const V ratio = w / d.short_corner, b = d.short_damping / (1.0 + ratio * ratio);
        on_rotor = pick(d.short_damping > 0.0, on_rotor - pick(b < d.most_damping, b, d.most_damping) * w, on_rotor);
    }
}

// Friction of a closing mechanical brake on the rotor.
DP_INLINE V braked(Drive &d, V w, V delay, double dt) {
    const V dead = 0.5 * delay;
    const Mask on = d.brake > 0.0;
    const V share = pick(d.closing < delay, (d.closing - dead) / dead, all(1.0));
    d.closing = pick(on, d.closing + dt, d.closing);
    const Mask bites = on & (share > 0.0);
    const V level = share * d.brake;
    const V z = clamp(d.brake_z + 0.5 * d.presliding_stiffness * (w * dt), level);
    d.brake_z = pick(bites, z, d.brake_z);
    return pick(bites, clamp(d.brake_z + 0.5 * d.presliding_damping * w, level), V{});
}

// Reads the new state: element forces, transmitted torque, sensor.
DP_INLINE void observe(Drive &d, V e, V de, V w, double dt, long step, dp_lane *lane, int j, int lanes) {
    V tau = -(d.stiffness * e + d.damping * de);
    if (d.has_gap) tau = pick(d.half_gap > 0.0, tau + d.stiffness * clamp(e, d.half_gap), tau);
    if (d.has_hysteresis) {
        const Mask has = d.hysteresis > 0.0;
        const V z = clamp(d.hysteresis_z + d.hysteresis_stiffness * (de * dt), d.hysteresis);
        d.hysteresis_z = pick(has, z, d.hysteresis_z);
        tau = pick(has, tau - z, tau);
    }
    if (d.has_friction) {
        V level = d.coulomb;
        if (d.has_stribeck) {
            const V ratio = w * d.stribeck_rate;
            level += pick(d.stribeck > 0.0, d.stribeck * decay(ratio * ratio), V{});
        }
        const V elastic = slip(d.friction_z, w * dt, d.presliding_stiffness, level);
        d.friction = clamp(elastic + d.presliding_damping * w, level);
    }
    V seen = tau;
    if (d.has_delay)
        for (int l = 0; l < lanes; l++)
            if (d.delay[l] > 0) {
                double *slot = &lane[l].a.drive[j].delay[step % d.delay[l]];
                seen[l] = *slot;
                *slot = tau[l];
            }
    if (d.has_filter) {
        const Mask has = d.filtered > 0.0;
        const V x0 = d.filter_x[0], x1 = d.filter_x[1];
        d.filter_x[0] = d.filter_a[0] * x0 + d.filter_a[1] * x1 + d.filter_b[0] * seen;
        d.filter_x[1] = d.filter_a[2] * x0 + d.filter_a[3] * x1 + d.filter_b[1] * seen;
        seen = pick(has, d.filter_x[0], seen);
    }
    d.sum += 0.5 * (d.measured_tau + seen);
    d.measured_tau = seen;
    d.tau = tau;
}

// A healthy drive's numbers and its state after dp_begin, once per lane.
static void load(Drive &d, int l, const dp_drive &s, bool reference) {
    d.stiffness[l] = s.stiffness, d.damping[l] = s.damping, d.half_gap[l] = s.half_gap;
    d.hysteresis[l] = s.hysteresis, d.hysteresis_stiffness[l] = s.hysteresis_stiffness;
    d.coulomb[l] = s.coulomb, d.stribeck[l] = s.stribeck, d.stribeck_rate[l] = s.stribeck_rate;
    d.presliding_stiffness[l] = s.presliding_stiffness, d.presliding_damping[l] = s.presliding_damping;
    d.stop_lower[l] = s.stop_lower, d.stop_upper[l] = s.stop_upper;
    d.stop_stiffness[l] = s.stop_stiffness, d.stop_damping[l] = s.stop_damping;
    d.actuator_gain[l] = s.actuator_gain, d.inner_pole[l] = s.inner_pole;
    for (int k = 0; k < 4; k++) d.filter_a[k][l] = s.filter_a[k / 2][k % 2];
    for (int k = 0; k < 2; k++) d.filter_b[k][l] = s.filter_b[k], d.filter_x[k][l] = s.filter_x[k];
    d.servo_kp[l] = s.servo_kp, d.servo_kd[l] = s.servo_kd, d.servo_ki[l] = s.servo_ki;
    d.filtered[l] = s.filtered, d.servo[l] = s.control < 0 && reference;
    d.friction_z[l] = s.friction_z, d.hysteresis_z[l] = s.hysteresis_z, d.integral[l] = s.integral;
    d.friction[l] = s.friction, d.tau[l] = s.tau, d.measured_tau[l] = s.measured_tau;
    d.delay[l] = s.sensor_delay, d.inner_steps[l] = s.inner_steps;
    d.has_gap |= s.half_gap > 0.0, d.has_hysteresis |= s.hysteresis > 0.0;
    d.has_friction |= s.coulomb > 0.0 || s.stribeck > 0.0, d.has_stribeck |= s.stribeck > 0.0;
    d.has_delay |= s.sensor_delay > 0, d.has_filter |= s.filtered != 0;
    d.has_inner |= s.inner_gain > 0.0, d.has_servo |= d.servo[l] > 0.0;
}

// What the code at a tick may change.
DP_INLINE void take(Drive &d, int l, const dp_drive &s) {
    d.torque_limit[l] = s.torque_limit, d.servo_limit[l] = s.servo_limit, d.motor_limit[l] = s.motor_limit;
    d.inner_gain[l] = s.inner_gain, d.inner_torque[l] = s.inner_torque, d.inner_correction[l] = s.inner_correction;
    d.sum[l] = s.sum, d.motor[l] = s.motor, d.gravity[l] = s.gravity;
}

// What the code at a tick reads.
DP_INLINE void give(const Drive &d, int l, dp_drive &s) {
    s.tau = d.tau[l], s.sum = d.sum[l], s.measured_tau = d.measured_tau[l], s.asked = d.asked[l];
    s.inner_torque = d.inner_torque[l], s.inner_correction = d.inner_correction[l];
}

}  // namespace
