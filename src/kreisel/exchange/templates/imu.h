/* {{ device }}: calibration by kreisel {{ version }}, for C99 and C++.
 *
 * From raw readings (rad/s, m/s^2) to the true angular rate against inertial space and the specific force
 * (upward +9.8 m/s^2 at rest), in these axes: {{ axes }}.
{%- for note in notes %}
 * {{ note }}
{%- endfor %}
 *
 *     {{ name }}_stream stream = { 0 }; // in C++: {{ name }}_stream stream{};
 *     {{ name }}_sample out;
 *     if ({{ name }}_push(&stream, stamp_ns, w_raw, a_raw, temperature_c, &out))
 *         use(out.stamp_ns, out.rate, out.force);
 *
 * The result belongs to the sample {{ late_by }} before the one pushed: angular acceleration, which the positions of the
 * accelerometers need, is the slope of the cubic closest to seven samples. {{ name }}_rate and {{ name }}_force are
 * the same without a delay, with derivatives of yours.
 *
 * Define {{ NAME }}_REAL as float before including this file for single precision. No heap, no libraries.
 */
#ifndef {{ NAME }}_CALIBRATION_H
#define {{ NAME }}_CALIBRATION_H

#include <stdint.h>

#ifndef {{ NAME }}_REAL
#define {{ NAME }}_REAL double
#endif

#define {{ NAME }}_TEMPERATURE {{ '1' if needs_temperature else '0' }} /* whether temperature_c is used */
#define {{ NAME }}_LATER {{ later }} /* samples that a corrected rate needs after its own */
#define {{ NAME }}_GAP_NS {{ gap_ns }} /* after more than this between two samples a new run of seven begins */

typedef struct {
    int64_t stamp_ns;
    {{ NAME }}_REAL rate[3];  /* rad/s */
    {{ NAME }}_REAL force[3]; /* m/s^2 */
} {{ name }}_sample;

typedef struct {
    int64_t stamp_ns[7 + {{ NAME }}_LATER];
    {{ NAME }}_REAL rate[7][3];
    {{ NAME }}_REAL w[7 + {{ NAME }}_LATER][3];
    {{ NAME }}_REAL a[7 + {{ NAME }}_LATER][3];
    {{ NAME }}_REAL temperature[7 + {{ NAME }}_LATER];
    int count;
} {{ name }}_stream;

/* Angular rate from raw readings w and a, and the first two derivatives dw and ddw (used only if the calibration has a
 * delay or a smoothing of gyro axes). Temperature in degrees Celsius. */
static inline void {{ name }}_rate(const {{ NAME }}_REAL w[3], const {{ NAME }}_REAL dw[3], const {{ NAME }}_REAL ddw[3],
                            const {{ NAME }}_REAL a[3], {{ NAME }}_REAL temperature_c, {{ NAME }}_REAL rate[3])
{
    typedef {{ NAME }}_REAL real;
    const real temperature_difference = temperature_c - {{ real(temperature) }};
    const real x[3] = {
{%- for terms in gyro %}
        {{ terms }}{{ "," if not loop.last }}
{%- endfor %}
    };
    (void)a;
    (void)dw;
    (void)ddw;
    (void)temperature_difference;
{%- for row in K_omega %}
    rate[{{ loop.index0 }}] = {{ row }};
{%- endfor %}
}

/* Specific force at the origin from raw accelerations a, their first two derivatives da and dda (used only if the
 * calibration has a delay), the angular rate (rad/s) and the angular acceleration (rad/s^2). */
static inline void {{ name }}_force(const {{ NAME }}_REAL a[3], const {{ NAME }}_REAL da[3], const {{ NAME }}_REAL dda[3],
                             const {{ NAME }}_REAL rate[3], const {{ NAME }}_REAL alpha[3],
                             {{ NAME }}_REAL temperature_c, {{ NAME }}_REAL force[3])
{
    typedef {{ NAME }}_REAL real;
    /* sensitive axes and positions (m) of the accelerometers */
    static const real axis[3][3] = {
{%- for row in sensitive %}
        { {{ row }} }{{ "," if not loop.last }}
{%- endfor %}
    };
    static const real place[3][3] = {
{%- for row in places %}
        { {{ row }} }{{ "," if not loop.last }}
{%- endfor %}
    };
    const real temperature_difference = temperature_c - {{ real(temperature) }};
    const real w[3] = { rate[0], rate[1], rate[2] };
    const real square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2];
    real x[3] = {
{%- for terms in accel %}
        {{ terms }}{{ "," if not loop.last }}
{%- endfor %}
    };
    int j;
    (void)da;
    (void)dda;
    (void)temperature_difference;
    for (j = 0; j < 3; ++j) {
        const real *r = place[j];
        const real along = w[0] * r[0] + w[1] * r[1] + w[2] * r[2];
        x[j] -= axis[j][0] * (alpha[1] * r[2] - alpha[2] * r[1] + w[0] * along - square * r[0])
              + axis[j][1] * (alpha[2] * r[0] - alpha[0] * r[2] + w[1] * along - square * r[1])
              + axis[j][2] * (alpha[0] * r[1] - alpha[1] * r[0] + w[2] * along - square * r[2]);
    }
{%- for row in K_a %}
    force[{{ loop.index0 }}] = {{ row }};
{%- endfor %}
}

/* Weights of seven values in the first and second derivative, at the middle one, of the cubic closest to them. */
static inline void {{ name }}_weights(const int64_t stamp_ns[7], {{ NAME }}_REAL slope[7], {{ NAME }}_REAL curvature[7])
{
    typedef {{ NAME }}_REAL real;
    const real span = (real)(stamp_ns[6] - stamp_ns[0]) * {{ real(1e-9) }};
    real u[7], p[7], before[7];
    real at[3] = { {{ real(1.0) }}, {{ real(0.0) }}, {{ real(0.0) }} };
    real at_before[3] = { {{ real(0.0) }}, {{ real(0.0) }}, {{ real(0.0) }} };
    real size_before = {{ real(1.0) }};
    int degree, k;
    for (k = 0; k < 7; ++k) {
        u[k] = (real)(stamp_ns[k] - stamp_ns[3]) * {{ real(1e-9) }} / span;
        p[k] = {{ real(1.0) }};
        before[k] = slope[k] = curvature[k] = {{ real(0.0) }};
    }
    for (degree = 0; degree < 4; ++degree) { /* polynomials that are orthogonal on the samples */
        real size = {{ real(0.0) }}, a = {{ real(0.0) }}, b, next[3];
        for (k = 0; k < 7; ++k) {
            size += p[k] * p[k];
            a += u[k] * p[k] * p[k];
        }
        a /= size;
        b = degree ? size / size_before : {{ real(0.0) }};
        for (k = 0; k < 7; ++k) {
            const real now = p[k];
            slope[k] += now * at[1] / size;
            curvature[k] += now * at[2] / size;
            p[k] = (u[k] - a) * now - b * before[k];
            before[k] = now;
        }
        next[0] = -a * at[0] - b * at_before[0];
        next[1] = at[0] - a * at[1] - b * at_before[1];
        next[2] = at[1] + at[1] - a * at[2] - b * at_before[2];
        for (k = 0; k < 3; ++k) {
            at_before[k] = at[k];
            at[k] = next[k];
        }
        size_before = size;
    }
    for (k = 0; k < 7; ++k) {
        slope[k] /= span;
        curvature[k] /= span * span;
    }
}

/* First two derivatives of x (7 x 3), at the middle one, of the cubics closest to it. */
static inline void {{ name }}_derivatives(const int64_t stamp_ns[7], const {{ NAME }}_REAL *x, {{ NAME }}_REAL dx[3],
                                  {{ NAME }}_REAL ddx[3])
{
    typedef {{ NAME }}_REAL real;
    real slope[7], curvature[7];
    int j, k;
    {{ name }}_weights(stamp_ns, slope, curvature);
    for (j = 0; j < 3; ++j) {
        dx[j] = ddx[j] = {{ real(0.0) }};
        for (k = 0; k < 7; ++k) {
            dx[j] += slope[k] * x[3 * k + j];
            ddx[j] += curvature[k] * x[3 * k + j];
        }
    }
}

/* Take one sample. Return 1 if *out is the result of the sample {{ late_by }} before it, else 0. */
static inline int {{ name }}_push({{ name }}_stream *stream, int64_t stamp_ns, const {{ NAME }}_REAL w_raw[3],
                           const {{ NAME }}_REAL a_raw[3], {{ NAME }}_REAL temperature_c, {{ name }}_sample *out)
{
    typedef {{ NAME }}_REAL real;
    enum { later = {{ NAME }}_LATER, last = 6 + later };
    real dx[3] = { {{ real(0.0) }}, {{ real(0.0) }}, {{ real(0.0) }} };
    real ddx[3] = { {{ real(0.0) }}, {{ real(0.0) }}, {{ real(0.0) }} };
    real alpha[3], unused[3];
    int j, k;
    if (stream->count > 0) {
        const int64_t step = stamp_ns - stream->stamp_ns[last];
        if (step <= 0 || step > {{ NAME }}_GAP_NS)
            stream->count = 0;
    }
    for (k = 0; k < last; ++k) {
        stream->stamp_ns[k] = stream->stamp_ns[k + 1];
        stream->temperature[k] = stream->temperature[k + 1];
        for (j = 0; j < 3; ++j) {
            stream->w[k][j] = stream->w[k + 1][j];
            stream->a[k][j] = stream->a[k + 1][j];
        }
    }
    for (k = 0; k < 6; ++k)
        for (j = 0; j < 3; ++j)
            stream->rate[k][j] = stream->rate[k + 1][j];
    stream->stamp_ns[last] = stamp_ns;
    stream->temperature[last] = temperature_c;
    for (j = 0; j < 3; ++j) {
        stream->w[last][j] = w_raw[j];
        stream->a[last][j] = a_raw[j];
    }
    if (stream->count < 7 + 2 * later)
        ++stream->count;
    if (later > 0 && stream->count < 7)
        return 0;
    if (later > 0)
        {{ name }}_derivatives(stream->stamp_ns + later, stream->w[later], dx, ddx);
    {{ name }}_rate(stream->w[6], dx, ddx, stream->a[6], stream->temperature[6], stream->rate[6]);
    if (stream->count < 7 + 2 * later)
        return 0;
    out->stamp_ns = stream->stamp_ns[3];
    for (j = 0; j < 3; ++j)
        out->rate[j] = stream->rate[3][j];
    {{ name }}_derivatives(stream->stamp_ns, stream->rate[0], alpha, unused);
    {{ name }}_derivatives(stream->stamp_ns, stream->a[0], dx, ddx);
    {{ name }}_force(stream->a[3], dx, ddx, out->rate, alpha, stream->temperature[3], out->force);
    return 1;
}

#endif
