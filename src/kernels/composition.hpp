/// Preintegrated motion onto the navigation state, and from there to the reference's own time.
#pragma once

#include "samples.hpp"

namespace {

/// Navigation state of four sigma points.
struct Navigation {
    Quaternion<Lanes> q;
    Vector<Lanes> v, p;
};

/// Carry a navigation state over an interval of T seconds: equation (9).
///
/// Solves equations (4) and (5), v' = C f + g - 2 Omega x v, with gravity g and Earth rate Omega constant in r. With E the
/// turn of r during the interval and y the displacement seen from where r stood at its beginning,
/// d^2 y / dt^2 = C_0 (Delta C f) + E^-1 g + Omega x (Omega x y); the last term is left out (below 6e-9 m/s^2 for
/// displacements under one metre).
inline Navigation compose(
    Lanes T, Navigation at, Quaternion<Lanes> dq, Vector<Lanes> dv, Vector<Lanes> dp, Vector<Lanes> g, Vector<Lanes> Omega
) {
    const Quaternion<Lanes> E = small_rotation(-T * Omega);
    const Vector<Lanes> Og = cross(Omega, g), OOg = cross(Omega, Og);
    const Vector<Lanes> y_dot = rotate(at.q, dv) + at.v + T * (g + (T * 0.5) * (Og + (T * (1.0 / 3.0)) * OOg));
    const Vector<Lanes> y =
        rotate(at.q, dp) + T * (at.v + (T * 0.5) * (g + (T * (1.0 / 3.0)) * (Og + (T * 0.25) * OOg)));
    return {E * at.q * dq, rotate(E, y_dot - cross(Omega, y)), at.p + rotate(E, y)};
}

/// What carries a navigation state on from the last sample of an interval.
struct End {
    Quaternion<Lanes> q_first;        // attitude at the first sample
    Vector<Lanes> omega, alpha;       // rate and angular acceleration at the last
    Vector<Lanes> before, here, after;  // specific force at the last sample and its neighbours, in b at the first
    Vector<Lanes> g, Omega;           // gravity and Earth rate in r
};

struct Pose {
    Quaternion<Lanes> q;
    Vector<Lanes> p;
};

/// The pose t seconds after the last sample, at most a sampling interval away: equation (12).
///
/// dt_before, dt_after: sampling intervals on either side of the last sample, s.
inline Pose pose_at(Lanes t, double dt_before, double dt_after, const End &end, Navigation at) {
    const Vector<Lanes> omega_rb = end.omega - rotate(conjugate(at.q), end.Omega);
    const Vector<Lanes> theta = t * (omega_rb + (0.5 * t) * end.alpha);
    const Vector<Lanes> rising = Lanes(1.0 / dt_before) * (end.here - end.before);
    const Vector<Lanes> falling = Lanes(1.0 / dt_after) * (end.after - end.here);
    const Vector<Lanes> slope =
        Lanes(1.0 / (dt_before + dt_after)) * (Lanes(dt_after) * rising + Lanes(dt_before) * falling);
    const Vector<Lanes> a = rotate(end.q_first, end.here) + end.g - Lanes(2.0) * cross(end.Omega, at.v);
    const Vector<Lanes> jerk = rotate(end.q_first, slope);
    return {at.q * small_rotation(theta), at.p + t * (at.v + (0.5 * t) * (a + (t * (1.0 / 3.0)) * jerk))};
}

}  // namespace
