/// The motion of the parameter sets against the first one, the centre, over blocks of samples.
///
/// The sets differ from the centre little, and what they differ by is the same few products of the raw readings for all
/// of them. These are summed over blocks of samples once. Each set then turns against the centre by one small rotation
/// a block, and its specific force is a combination of the block's sums: the cost of a set depends on the number of
/// blocks, not of samples. Blocks are as long as the second order of the turn within them stays below rounding of the
/// readings.
#pragma once

#include "centre_path.hpp"

namespace {

/// rad; how far a parameter set may turn against the centre within a block. Its square is what is neglected.
constexpr double SMALL_TURN = 1e-4;

/// The sets against the centre, and the sums over all samples.
struct Relative {
    Columns q;              // (4, m): how they have turned at the last sample, seen from the attitude at the first
    Columns neighbours[2];  // (3, m): how they turn on from there to the sample before and after
    Table total;            // (18, features): sums of `sum_products` over all samples
};

/// How many samples a block may have for sets whose rate coefficients differ by `difference` (3 P, m).
inline Index block_length(Span span, const Samples &signal, Columns difference, Workspace &memory) {
    const Index P = signal.rates.rows, count = span.count();
    // of each set: the sum of |coefficient| times the largest |feature|
    const Columns reach = memory.zeros(3, difference.columns);
    for (Index f = 0; f < P; f++) {
        const double *rates = signal.rates.row(f) + span.low;
        Lanes most = 0.0;
        for (Index k = 0; k < count; k += LANES) most = larger(most, absolute(load(rates + k, count - k)));
        const double peak = largest(most);
        for (Index s = 0; s < difference.columns; s += LANES) {
            const Vector<Lanes> d = difference.vector(3 * f, s);
            reach.set(s, reach.vector(s) + Lanes(peak) * Vector<Lanes>{absolute(d.x), absolute(d.y), absolute(d.z)});
        }
    }
    Lanes fastest = 0.0;
    for (Index s = 0; s < reach.columns; s += LANES) fastest = larger(fastest, dot(reach.vector(s), reach.vector(s)));
    const double turned = std::sqrt(largest(fastest)) * (signal.stamps[span.high] - signal.stamps[span.low]);
    if (!(turned > SMALL_TURN)) return count;
    const Index length = static_cast<Index>(SMALL_TURN / turned * static_cast<double>(count));
    return length > 1 ? length : 1;
}

/// Write how far a unit of difference in each rate coefficient turns a set over each interval, (c - 1, 9 Q), Q = P
/// padded: entry (3 i + r) Q + f is the integral of C_ir times feature f, about axis i.
///
/// It is the mean of C (of the cubic through four samples, of a line at either end) times the feature's integral, and
/// what both change together.
template <bool Effects>
inline void unit_turns(Span span, const Samples &signal, Columns C, Table units, Workspace &memory) {
    const Features<Effects> of(signal.rates.rows);
    const Index P = of.P, Q = of.Q, count = span.count(), intervals = count - 1;
    const Columns mean = memory.columns(9, count), change = memory.columns(9, count);
    for (Index i = 0; i < 9; i++) {
        const double *c = C.row(i);
        double *m = mean.row(i), *d = change.row(i);
        Index j = 1;
        for (; j + LANES < intervals; j += LANES) {
            const Lanes here = load(c + j), next = load(c + j + 1), both = here + next;
            store(0.5 * both - (1.0 / 24.0) * (load(c + j + 2) - both + load(c + j - 1)), m + j);
            store(next - here, d + j);
        }
        for (Index k : {Index(0), j, j + 1, j + 2, j + 3}) {
            if (k >= intervals) continue;
            const double both = c[k] + c[k + 1], curved = 0 < k && k < intervals - 1 ? c[k + 2] - both + c[k - 1] : 0.0;
            m[k] = 0.5 * both - (1.0 / 24.0) * curved;
            d[k] = c[k + 1] - c[k];
        }
    }
    // Integrals of the features, and what their slopes add, of one interval side by side.
    const Table integral = {memory.numbers(padded(intervals) * Q), intervals, Q};
    const Table slope = {memory.numbers(padded(intervals) * Q), intervals, Q};
    const Index n = signal.stamps.count;
    const From stamps(signal.stamps.data, span.low, n), next(signal.stamps.data, span.low + 1, n);
    for (Index j = 0; j < intervals; j += LANES) {
        const Lanes h = next[j] - stamps[j], share = h * h * (1.0 / 24.0);
        Lanes whole[MAX_FEATURES], rising[MAX_FEATURES];
        for (Index f = 0; f < P; f++) {
            whole[f] = From(signal.integrals.row(f), span.low, n - 1)[j];
            rising[f] = 0.0;
            if (f >= RATES) continue;  // an effect's feature may have steps: it counts with its mean
            const double *slopes = signal.slopes.row(f);
            rising[f] = share * (From(slopes, span.low, n)[j] + From(slopes, span.low + 1, n)[j]);
        }
        set_features(whole, P, integral, j);
        set_features(rising, P, slope, j);
    }
    for (Index j = 0; j < intervals; j++) {
        for (Index f = 0; f < Q; f += LANES) {
            const Lanes whole = load(integral.row(j) + f), rising = load(slope.row(j) + f);
            for (Index i = 0; i < 9; i++) {
                store(Lanes(mean(i, j)) * whole + Lanes(change(i, j)) * rising, units.row(j) + i * Q + f);
            }
        }
    }
}

/// Add sum_fr turns[(3 i + r) Q + f] difference[3 f + r, s] to column s, for component i.
template <bool Effects>
inline Vector<Lanes> contract(const double *turns, Columns difference, Index s) {
    const Features<Effects> of(difference.rows / 3);
    const Index P = of.P, Q = of.Q;
    Vector<Lanes> out = {0.0, 0.0, 0.0};
    for (Index f = 0; f < P; f++) {
        const Vector<Lanes> d = difference.vector(3 * f, s);
        const double *t = turns + f;
        out.x += Lanes(t[0]) * d.x + Lanes(t[Q]) * d.y + Lanes(t[2 * Q]) * d.z;
        out.y += Lanes(t[3 * Q]) * d.x + Lanes(t[4 * Q]) * d.y + Lanes(t[5 * Q]) * d.z;
        out.z += Lanes(t[6 * Q]) * d.x + Lanes(t[7 * Q]) * d.y + Lanes(t[8 * Q]) * d.z;
    }
    return out;
}

/// sum_jf sums[3 i + j, f] coefficients[3 f + j, s] for component i; sums (9, features).
template <bool Effects>
inline Vector<Lanes> combine(Table sums, Columns coefficients, Index s) {
    const Index features = Effects ? coefficients.rows / 3 : FEATURES;
    Vector<Lanes> out = {0.0, 0.0, 0.0};
    for (Index f = 0; f < features; f++) {
        const Vector<Lanes> x = coefficients.vector(3 * f, s);
        const double *a = sums.data + f;
        const Index n = Effects ? sums.columns : padded(FEATURES);
        out.x += Lanes(a[0]) * x.x + Lanes(a[n]) * x.y + Lanes(a[2 * n]) * x.z;
        out.y += Lanes(a[3 * n]) * x.x + Lanes(a[4 * n]) * x.y + Lanes(a[5 * n]) * x.z;
        out.z += Lanes(a[6 * n]) * x.x + Lanes(a[7 * n]) * x.y + Lanes(a[8 * n]) * x.z;
    }
    return out;
}

/// Write the weighted sums of C_ij times features of the force over samples, for G groups of lanes from `first` on.
template <int G>
inline void sum_some_products(Index begin, Index end, const Path &path, Index first, Table sums) {
    const Index features = path.psi.columns;
    for (Index i = 0; i < 9; i++) {
        const double *velocity = path.weighted.row(2 * i), *position = path.weighted.row(2 * i + 1);
        Lanes v[G], p[G];
        for (int g = 0; g < G; g++) v[g] = p[g] = 0.0;
        for (Index j = begin; j < end; j++) {
            const Lanes a = velocity[j], b = position[j];
            const double *psi = path.psi.data + j * features + first;
            for (int g = 0; g < G; g++) {
                const Lanes feature = load(psi + g * LANES);
                v[g] += a * feature;
                p[g] += b * feature;
            }
        }
        for (int g = 0; g < G; g++) {
            store(v[g], sums.row(i) + first + g * LANES);
            store(p[g], sums.row(9 + i) + first + g * LANES);
        }
    }
}

/// Write the sums of weights times C_ij times features over samples: (18, features), first for the velocity.
inline void sum_products(Index begin, Index end, const Path &path, Table sums) {
    Index g = 0;
    for (; g + 4 * LANES <= sums.columns; g += 4 * LANES) sum_some_products<4>(begin, end, path, g, sums);
    for (; g < sums.columns; g += LANES) sum_some_products<1>(begin, end, path, g, sums);
}

/// Write the sums of `unit_turns` times what is carried, (c, 8), over samples to (6, 9 Q), for G groups of lanes.
template <int G>
inline void sum_some_turns(Index begin, Index end, const double *carried, Table units, Index first, Table turns) {
    Lanes sums[6][G];
    for (int x = 0; x < 6; x++) {
        for (int g = 0; g < G; g++) sums[x][g] = 0.0;
    }
    for (Index j = begin; j < end; j++) {
        for (int g = 0; g < G; g++) {
            const Lanes unit = load(units.row(j) + first + g * LANES);
            for (int x = 0; x < 6; x++) sums[x][g] += Lanes(carried[2 * LANES * j + x + x / 3]) * unit;
        }
    }
    for (int x = 0; x < 6; x++) {
        for (int g = 0; g < G; g++) store(sums[x][g], turns.row(x) + first + g * LANES);
    }
}

/// Write the sums of `unit_turns` I_k times R_k over a block, (6, 9 Q).
///
/// R_k is the sum of weights times forces of the samples that the turn I_k moves: those after k, or those up to k and
/// with a minus, as k lies after the block's centre or before it. The first three rows are its components with the
/// weights of the velocity, the others with those of the position. carried (c, 8) is scratch.
inline void sum_turns(
    Index begin, Index centre, Index end, const Path &path, Table units, double *carried, Table turns
) {
    const double *velocity = path.weights.row(0), *position = path.weights.row(1);
    Lanes v = 0.0, p = 0.0;
    const auto carry = [&](Index j) {
        store(v, carried + 2 * LANES * j);
        store(p, carried + 2 * LANES * j + LANES);
    };
    for (Index j = begin; j < centre; j++) {
        v -= velocity[j] * load(path.u.row(j));
        p -= position[j] * load(path.u.row(j));
        carry(j);
    }
    v = p = 0.0;
    for (Index j = end - 2; j >= centre; j--) {
        v += velocity[j + 1] * load(path.u.row(j + 1));
        p += position[j + 1] * load(path.u.row(j + 1));
        carry(j);
    }
    Index g = 0;
    for (; g + 2 * LANES <= turns.columns; g += 2 * LANES) sum_some_turns<2>(begin, end - 1, carried, units, g, turns);
    for (; g < turns.columns; g += LANES) sum_some_turns<1>(begin, end - 1, carried, units, g, turns);
}

/// Write what turns of samples, (6, 9 Q), make of velocity (which = 0) or position, (9 Q,): turn x force.
inline void levers(Table turns, Index which, Index Q, double *lever) {
    for (Index i = 0; i < 3; i++) {
        const Index j = (i + 1) % 3, k = (i + 2) % 3;
        for (Index x = 0; x < 3 * Q; x++) {
            lever[3 * i * Q + x] = turns(3 * which + k, 3 * j * Q + x) - turns(3 * which + j, 3 * k * Q + x);
        }
    }
}

/// How the sets turned in the last step: the next one needs it for the change of the turn's axis.
struct Turning {
    Columns theta;      // (3, m)
    double span = 0.0;  // s
};

/// Turn q (4, m) against the centre from one sample to another.
template <bool Effects>
inline void advance(
    Span span, const Samples &signal, Index begin, Index end, Table units, Columns difference, double *turns,
    Turning &last, Columns q
) {
    const double now = signal.stamps[span.low + end] - signal.stamps[span.low + begin];
    const double sign = end > begin ? 1.0 : -1.0;
    for (Index f = 0; f < units.columns; f += LANES) {
        Lanes total = 0.0;
        for (Index j = begin < end ? begin : end; j < (begin < end ? end : begin); j++) total += load(units.row(j) + f);
        store(sign * total, turns + f);
    }
    // The classic two-interval form: what the change of the turn's axis adds to it.
    const double before = last.span;
    const double share = before > 0.0 && now > 0.0 ? now * now / (6.0 * before * (now + before)) : 0.0;
    for (Index s = 0; s < q.columns; s += LANES) {
        const Vector<Lanes> theta = contract<Effects>(turns, difference, s), earlier = last.theta.vector(s);
        last.theta.set(s, theta);
        q.set(s, q.quaternion(s) * small_rotation(theta + share * cross(earlier, theta)));
    }
    last.span = now;
}

/// Write dv and dp (3, M) of the sets with gyro parameters of their own, block by block, and fill `relative`.
template <bool Effects>
inline void relative_motion(
    Span span, const Samples &signal, const Coefficients &coefficients, const Path &path, Relative &relative,
    const Increments &out, Workspace &memory
) {
    const Columns rate = coefficients.rate, force = coefficients.force;
    const Features<Effects> of(rate.rows / 3);
    const Index count = span.count(), Q = of.Q, features = path.psi.columns;
    const Columns difference = memory.columns(rate.rows, coefficients.m);
    for (Index row = 0; row < rate.rows; row++) {
        for (Index s = 0; s < rate.columns; s += LANES) {
            store(load(rate.row(row) + s) - Lanes(rate(row, 0)), difference.row(row) + s);
        }
    }
    const Index length = block_length(span, signal, difference, memory), blocks = (count + length - 1) / length;
    const Table units = {memory.numbers((count - 1) * 9 * Q), count - 1, 9 * Q};
    unit_turns<Effects>(span, signal, path.C, units, memory);
    const Table sums = {memory.numbers(18 * features), 18, features}, turns = {memory.numbers(54 * Q), 6, 9 * Q};
    double *carried = memory.numbers(2 * LANES * count), *lever = memory.numbers(9 * Q), *turned = memory.numbers(9 * Q);
    Turning last = {memory.zeros(3, coefficients.m)};
    fill(out.dv, 0.0);
    fill(out.dp, 0.0);
    Index at = span.first - span.low;
    for (Index b = 0; b < blocks; b++) {
        const Index begin = b * count / blocks, end = (b + 1) * count / blocks, centre = (begin + end) / 2;
        sum_products(begin, end, path, sums);
        for (Index i = 0; i < 18 * features; i++) relative.total.data[i] += sums.data[i];
        sum_turns(begin, centre, end, path, units, carried, turns);
        advance<Effects>(span, signal, at, centre, units, difference, turned, last, relative.q);
        at = centre;
        for (Index which = 0; which < 2; which++) {
            levers(turns, which, Q, lever);
            const Columns increment = which == 0 ? out.dv : out.dp;
            const Table own = {sums.row(9 * which), 9, features};
            for (Index s = 0; s < rate.columns; s += LANES) {
                const Vector<Lanes> part = combine<Effects>(own, force, s) + contract<Effects>(lever, difference, s);
                increment.set(s, increment.vector(s) + rotate(relative.q.quaternion(s), part));
            }
        }
    }
    const Index end = span.last - span.low;
    advance<Effects>(span, signal, at, end, units, difference, turned, last, relative.q);
    for (Index s = 0; s < rate.columns; s += LANES) {
        relative.neighbours[0].set(s, -contract<Effects>(units.row(end - 1), difference, s));
        if (end < count - 1) relative.neighbours[1].set(s, contract<Effects>(units.row(end), difference, s));
    }
}

}  // namespace
