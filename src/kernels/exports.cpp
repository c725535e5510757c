/// What Python calls, once for each set of instructions: KREISEL(name) is `kreisel_<variant>_<name>`.
///
/// Every function returns 0; 1 if there is no memory, 2 if parts of the library do not fit together. Lengths and indices
/// are checked by the caller. Arrays whose last axis is one of columns have it padded, see arrays.hpp.

#include "calls.hpp"
#include "chain.hpp"
#include "filter.hpp"
#include "layout.hpp"
#include "node_elimination.hpp"
#include "quadrature.hpp"
#include "recursions.hpp"
#include "rotation_fit.hpp"
#include "slope_recursions.hpp"
#include "strapdown_pass.hpp"
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

EXPORTED int KREISEL(inflate)(Table upper, Indices degrees, ConstNumbers deviations) {
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

EXPORTED int KREISEL(interval_weights)(ConstNumbers stamps, Indices base, Table single, Table twice) {
    interval_weights(stamps, base, single, twice);
    return DONE;
}

EXPORTED int KREISEL(integrate_intervals)(Indices base, ConstTable single, ConstTable values, Table out) {
    integrate_intervals(base, single, values, out);
    return DONE;
}

EXPORTED int KREISEL(differentiate)(ConstNumbers stamps, Indices first, ConstTable values, Table out) {
    differentiate(stamps, first, values, out);
    return DONE;
}

EXPORTED int KREISEL(double_integral)(ConstNumbers stamps, ConstTable values, Indices before, ConstNumbers share, Table out) {
    double_integral(stamps, values, before, share, out);
    return DONE;
}

EXPORTED int KREISEL(interpolate)(ConstNumbers stamps, ConstTable values, ConstNumbers moments, WrittenIndices after, Table out) {
    interpolate(stamps, values, moments, after, out);
    return DONE;
}

EXPORTED int KREISEL(integrate_attitude)(ConstNumbers stamps, ConstTable rates, ConstTable integrals, ConstTable coefficients, Table q) {
    integrate_attitude(stamps, rates, integrals, coefficients, q);
    return DONE;
}

EXPORTED int KREISEL(compare_rotations)(
    const RateSignal *signal, ConstTable q, Table K, ConstNumbers b, ConstTable t, ConstTable rotations, Table turned, Table residual, Table slope
) {
    compare_rotations(*signal, q, block(K, 0, 0), vector_from(b.data), t, rotations, turned, residual, slope);
    return DONE;
}

EXPORTED int KREISEL(unit_forces)(Numbers q, ConstNumbers reading, Numbers omega, Numbers alpha, Numbers out) {
    unit_forces(
        quaternion_from(q.data), vector_from(reading.data), vector_from(omega.data), vector_from(alpha.data), out.data);
    return DONE;
}

EXPORTED int KREISEL(integrate_unit_forces)(
    ConstNumbers stamps, ConstTable q, ConstTable readings, ConstTable omega, ConstTable alpha, Indices before, ConstNumbers share, Table out
) {
    integrate_unit_forces(stamps, q, readings, omega, alpha, before, share, out);
    return DONE;
}

EXPORTED int KREISEL(chain_motion)(
    const Chain *chain, ConstTable angles, ConstTable rates, ConstTable accelerations, Table q, Table p, Table v, Table a, Table omega,
    Table alpha
) {
    chain_motion(*chain, angles, rates, accelerations, q, p, v, a, omega, alpha);
    return DONE;
}

EXPORTED int KREISEL(chain_derivatives)(
    const Chain *chain, ConstTable angles, double gravity, Stack regressor, Stack jacobian, Table torques
) {
    chain_derivatives(*chain, angles, gravity, regressor, jacobian, torques);
    return DONE;
}

EXPORTED int KREISEL(drive_oscillators)(ConstTable step, ConstNumbers now, ConstNumbers later, Table u, Stack x) {
    drive_oscillators(step, now, later, u, x);
    return DONE;
}

EXPORTED int KREISEL(gauss_markov)(ConstNumbers keep, ConstTable white, Table out) {
    gauss_markov(keep, white, out);
    return DONE;
}

EXPORTED int KREISEL(carry_terms)(
    ConstStack transition, ConstStack design, ConstStack gain, ConstTable keep, ConstTable functions, ConstTable moments,
    Indices function, Indices place, Indices direction, Indices axis, ConstStack seen, ConstStack axes, ConstStack axes_seen,
    Index position, Table state, Stack predictions
) {
    return guarded([&] {
        Workspace memory;
        carry_terms(
            {transition, design, gain, keep},
            {functions, moments, function, place, direction, axis, seen, axes, axes_seen, position}, state, predictions, memory);
    });
}

EXPORTED int KREISEL(carry_innovations)(
    ConstStack transition, ConstStack design, ConstStack gain, ConstTable keep, Stack innovations, Table state
) {
    return guarded([&] {
        Workspace memory;
        carry_innovations({transition, design, gain, keep}, innovations, state, memory);
    });
}

EXPORTED int KREISEL(carry_back)(
    ConstStack transition, ConstStack design, ConstStack gain, ConstTable keep, Stack weights, Indices rows_after, Stack after,
    Indices rows_before, Stack before, Table state
) {
    return guarded([&] {
        Workspace memory;
        carry_back({transition, design, gain, keep}, weights, rows_after, after, rows_before, before, state, memory);
    });
}

EXPORTED int KREISEL(eliminate)(
    const ChainRows *rows, ConstStack weights, Index alike, ConstTable of_nodes, ConstTable of_parameters, Table parameters,
    Stack information, Numbers log_evidence, Stack nodes
) {
    return guarded([&] {
        Workspace memory;
        eliminate(*rows, weights, alike, of_nodes, of_parameters, parameters, information, log_evidence, nodes, memory);
    });
}

EXPORTED int KREISEL(strapdown_pass)(
    ConstTable rates, ConstTable forces, ConstTable K_omega, ConstNumbers k_w, ConstTable K_a, ConstNumbers k_a, ConstNumbers gravity,
    double dt, Numbers out
) {
    out[0] = strapdown_pass(rates, forces, K_omega, k_w, K_a, k_a, gravity, dt);
    return DONE;
}

EXPORTED int KREISEL(read_rows)(
    Bytes text, WrittenIndices stamps, Table values, WrittenIndexTable places, WrittenIndices found
) {
    OddCells odd = {places.data, places.rows};
    found[0] = read_rows(text, stamps, values, odd);
    found[1] = odd.count;
    return DONE;
}

EXPORTED int KREISEL(write_rows)(ConstTable values, WrittenBytes text, WrittenIndices found) {
    found[0] = write_rows(values, text);
    return DONE;
}
