/// What Python calls, once for each set of instructions: KREISEL(name) is `kreisel_<variant>_<name>`.
///
/// Every function returns 0; 1 if there is no memory, 2 if parts of the library do not fit together. Lengths and indices
/// are checked by the caller. Arrays whose last axis is one of columns have it padded, see arrays.hpp.

#include "calls.hpp"
#include "chain.hpp"
#include "filter.hpp"
#include "layout.hpp"
#include "quadrature.hpp"
#include "recursions.hpp"
#include "rotation_fit.hpp"
#include "table.hpp"
#include "unit_forces.hpp"

EXPORTED const char *KREISEL(layout)() { return layout_text().c_str(); }

EXPORTED int KREISEL(run)(
    const Model *model, const Samples *signal, const Steps *steps, Index begin, Index end, const Gate *gate,
    const Gaussian *belief, const Record *record, Index *stopped
) {
    return guarded([&] { *stopped = run(*model, *signal, *steps, begin, end, *gate, *belief, *record); });
}

EXPORTED int KREISEL(triangularise)(Table rows) {
    return guarded([&] {
        Workspace memory;
        triangularise(rows, memory);
    });
}

EXPORTED int KREISEL(inflate)(Table upper, Indices degrees, Numbers deviations) {
    return guarded([&] {
        Workspace memory;
        const Columns own = copied(upper, memory);
        inflate(own, degrees, deviations.data, memory);
        copy(own, upper, upper.rows, upper.columns);
    });
}

EXPORTED int KREISEL(renew)(Table upper, Index first, double deviation) {
    return guarded([&] {
        Workspace memory;
        const Columns own = copied(upper, memory);
        renew(own, first, deviation, memory);
        copy(own, upper, upper.rows, upper.columns);
    });
}

EXPORTED int KREISEL(plus)(IndexTable parts, Numbers x, Table change, Table out) {
    return guarded([&] {
        Workspace memory;
        plus(parts, x.data, columns(change), columns(out), memory);
    });
}

EXPORTED int KREISEL(minus)(IndexTable parts, Table states, Numbers x, Table out) {
    return guarded([&] {
        Workspace memory;
        minus(parts, columns(states), x.data, columns(out), memory);
    });
}

EXPORTED int KREISEL(interval_weights)(Numbers stamps, Indices base, Table single, Table twice) {
    interval_weights(stamps, base, single, twice);
    return DONE;
}

EXPORTED int KREISEL(integrate_intervals)(Indices base, Table single, Table values, Table out) {
    integrate_intervals(base, single, values, out);
    return DONE;
}

EXPORTED int KREISEL(differentiate)(Numbers stamps, Indices first, Table values, Table out) {
    differentiate(stamps, first, values, out);
    return DONE;
}

EXPORTED int KREISEL(double_integral)(Numbers stamps, Table values, Indices before, Numbers share, Table out) {
    double_integral(stamps, values, before, share, out);
    return DONE;
}

EXPORTED int KREISEL(integrate_attitude)(Numbers stamps, Table rates, Table integrals, Table coefficients, Table q) {
    integrate_attitude(stamps, rates, integrals, coefficients, q);
    return DONE;
}

EXPORTED int KREISEL(compare_rotations)(
    const RateSignal *signal, Table q, Table K, Numbers b, Table t, Table rotations, Table turned, Table residual, Table slope
) {
    compare_rotations(*signal, q, block(K, 0, 0), vector_from(b.data), t, rotations, turned, residual, slope);
    return DONE;
}

EXPORTED int KREISEL(unit_forces)(Numbers q, Numbers reading, Numbers omega, Numbers alpha, Numbers out) {
    unit_forces(
        quaternion_from(q.data), vector_from(reading.data), vector_from(omega.data), vector_from(alpha.data), out.data);
    return DONE;
}

EXPORTED int KREISEL(integrate_unit_forces)(
    Numbers stamps, Table q, Table readings, Table omega, Table alpha, Indices before, Numbers share, Table out
) {
    integrate_unit_forces(stamps, q, readings, omega, alpha, before, share, out);
    return DONE;
}

EXPORTED int KREISEL(chain_motion)(
    const Chain *chain, Table angles, Table rates, Table accelerations, Table q, Table p, Table v, Table a, Table omega,
    Table alpha
) {
    chain_motion(*chain, angles, rates, accelerations, q, p, v, a, omega, alpha);
    return DONE;
}

EXPORTED int KREISEL(chain_derivatives)(
    const Chain *chain, Table angles, double gravity, Stack regressor, Stack jacobian, Table torques
) {
    chain_derivatives(*chain, angles, gravity, regressor, jacobian, torques);
    return DONE;
}

EXPORTED int KREISEL(drive_oscillators)(Table step, Numbers now, Numbers later, Table u, Stack x) {
    drive_oscillators(step, now, later, u, x);
    return DONE;
}

EXPORTED int KREISEL(gauss_markov)(Numbers keep, Table white, Table out) {
    gauss_markov(keep, white, out);
    return DONE;
}

EXPORTED int KREISEL(read_rows)(Bytes text, Indices stamps, Table values, IndexTable places, Indices found) {
    OddCells odd = {places.data, places.rows};
    found[0] = read_rows(text, stamps, values, odd);
    found[1] = odd.count;
    return DONE;
}
