/// Parts of the library that tests call one by one: `compiled_parts.py` compiles them beside it.

#include "../../src/kernels/calls.hpp"
#include "../../src/kernels/filter.hpp"
#include "../../src/kernels/layout.hpp"

EXPORTED const char *KREISEL(layout)() { return layout_text().c_str(); }

EXPORTED int KREISEL(rate_coefficients)(Stack K_omega, Table k_w0, Stack effects, Stack out) {
    rate_coefficients(columns(K_omega), columns(k_w0), columns(effects), columns(out));
    return DONE;
}

EXPORTED int KREISEL(force_coefficients)(
    Stack rate, Stack K_a, Table k_a0, Stack arms, Stack effects, Index printed, Index common, Stack out
) {
    force_coefficients(
        columns(rate), common != 0, columns(K_a), columns(k_a0), columns(arms), columns(effects),
        printed != 0, columns(out));
    return DONE;
}

/// Python's `MeasuredArrays`.
struct MeasuredArrays {
    Numbers innovation, passing;
    Table noise, factor;
    Numbers whitened;
    Table gain;
    Indices place;
};

EXPORTED int KREISEL(record_update)(const Record *record, Index i, const MeasuredArrays *of, Index n, Index used) {
    const double *moving = of->passing.data;
    const Passing passing = {{moving[0], moving[1], moving[2]}, {moving[3], moving[4], moving[5]}};
    const Measured measured = {of->innovation.data, passing, of->noise, of->factor, of->whitened.data, columns(of->gain)};
    record_update(*record, i, measured, of->place.data, n, used != 0);
    return DONE;
}

EXPORTED int KREISEL(turn)(Table q, Table theta) {
    turn_each(columns(q), columns(theta));
    return DONE;
}

EXPORTED int KREISEL(turn_between)(Numbers origin, Table q, Table out) {
    turn_between(quaternion_from(origin.data), columns(q), columns(out));
    return DONE;
}

/// What tests give and take of preintegration: Python's `IncrementArrays`.
struct IncrementArrays {
    Table dq, dv, dp, omega_end, alpha_end;
    Stack u_end;
    Table u_path, q_path;

    Increments columns() const {
        return {
            ::columns(dq), ::columns(dv), ::columns(dp), ::columns(omega_end), ::columns(alpha_end), ::columns(u_end),
            u_path, ::columns(q_path),
        };
    }
};

EXPORTED int KREISEL(preintegrate)(
    Index first, Index last, const Samples *signal, Stack rate, Stack force, Stack shared, Index m, Index others,
    const IncrementArrays *out
) {
    return guarded([&] {
        Workspace memory;
        const Coefficients coefficients = {columns(rate), columns(force), columns(shared), m, others};
        preintegrate(span_between(*signal, first, last), *signal, coefficients, out->columns(), memory);
    });
}

EXPORTED int KREISEL(noise_covariance)(
    Index first, Index last, Index every, const Samples *signal, Table u_path, Table q_path, Table K_omega, Table K_a,
    Table Q
) {
    return guarded([&] {
        Workspace memory;
        noise_covariance(
            span_between(*signal, first, last), every, *signal, u_path, columns(q_path), block(K_omega, 0, 0),
            block(K_a, 0, 0), Q, memory);
    });
}

EXPORTED int KREISEL(compose)(
    double duration, Table dq, Table dv, Table dp, Table gravity, Table earth_rate, Table q, Table v, Table p
) {
    const Columns q_rb = columns(q), v_r = columns(v), p_r = columns(p);
    for (Index s = 0; s < q.columns; s += LANES) {
        const Navigation moved = compose(
            duration, {q_rb.quaternion(s), v_r.vector(s), p_r.vector(s)}, columns(dq).quaternion(s),
            columns(dv).vector(s), columns(dp).vector(s), columns(gravity).vector(s), columns(earth_rate).vector(s));
        q_rb.set(s, moved.q);
        v_r.set(s, moved.v);
        p_r.set(s, moved.p);
    }
    return DONE;
}

/// Python's `MotionArrays`.
struct MotionArrays {
    Table q_first, omega, alpha;
    Stack force;
    Table gravity, earth_rate;

    IntegratedMotion columns() const {
        return {
            ::columns(q_first), ::columns(omega), ::columns(alpha), ::columns(force), ::columns(gravity),
            ::columns(earth_rate), {}, {},
        };
    }
};

EXPORTED int KREISEL(predict_poses)(
    const Model *model, const MotionArrays *motion, Table t, double dt_before, double dt_after, Table robot,
    Index at_standstill, Table states, Table q, Table p
) {
    return guarded([&] {
        Workspace memory;
        const Moment moment = {columns(t), dt_before, dt_after, columns(robot), at_standstill != 0};
        predict_poses(*model, motion->columns(), moment, {false}, columns(states), columns(q), columns(p), memory);
    });
}

EXPORTED int KREISEL(robot_motion)(const Model *model, Table regressor, const Gaussian *belief, Table out) {
    return guarded([&] {
        Workspace memory;
        const Columns upper = copied(belief->upper, memory);
        const Index n = upper.rows;
        const SigmaOrder order(model->gyro_degrees, model->sensor_degrees, n);
        copy(robot_motion(*model, order, regressor, belief->mean.data, upper, memory), out, 6, out.columns);
    });
}

EXPORTED int KREISEL(sample)(IndexTable parts, Index gyro, Index sensors, Numbers mean, Table upper, double spread, Table points) {
    return guarded([&] {
        Workspace memory;
        sample(parts, SigmaOrder(gyro, sensors, upper.rows), mean.data, upper, spread, columns(points), memory);
    });
}

/// Python's `UpdateArrays`.
struct UpdateArrays {
    Numbers mean;
    Table upper;                     // (n, n)
    Table points, noise, seen, prediction_noise;
    Numbers innovation;
    Table factor;
    Numbers nis;                     // (1,)
    Table innovation_factor;
    Numbers whitened;
    Table gain;                      // (m, n)
};

EXPORTED int KREISEL(update)(
    IndexTable parts, IndexTable tail, Index gyro, Index sensors, Numbers weights, const UpdateArrays *of, double gate
) {
    return guarded([&] {
        Workspace memory;
        const Index n = of->upper.rows, m = of->seen.rows;
        const Columns upper = copied(of->upper, memory), posterior = memory.zeros(n, n);
        const Updated done = update(
            parts, tail, SigmaOrder(gyro, sensors, n), weights, of->mean.data, upper,
            posterior, {columns(of->points), of->noise, columns(of->seen), columns(of->prediction_noise)}, of->innovation.data, of->factor,
            gate, memory);
        copy(posterior, of->upper, n, n);
        copy(done.gain, of->gain, m, n);
        copy(done.factor, of->innovation_factor, m, m);
        std::memcpy(of->whitened.data, done.whitened, m * sizeof(double));
        of->nis[0] = done.nis;
    });
}
