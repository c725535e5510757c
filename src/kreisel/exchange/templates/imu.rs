//! {{ device }}: calibration by kreisel {{ version }}.
//!
//! From raw readings (rad/s, m/s^2) to the true angular rate against inertial space and the specific force
//! (upward +9.8 m/s^2 at rest), in these axes: {{ axes }}.
{%- for note in notes %}
//! {{ note }}
{%- endfor %}
//!
//! `Stream::push` returns the result of the sample {{ late_by }} before the one pushed: angular acceleration, which the
//! positions of the accelerometers need, is the slope of the cubic closest to seven samples. Without std, without heap.

/// Whether the temperature is used.
pub const TEMPERATURE: bool = {{ 'true' if needs_temperature else 'false' }};

/// Samples that a corrected rate needs after its own.
const LATER: usize = {{ later }};

/// After more than this between two samples a new run of seven begins.
pub const GAP_NS: i64 = {{ gap_ns }};

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    pub stamp_ns: i64,
    /// rad/s
    pub rate: [f64; 3],
    /// m/s^2
    pub force: [f64; 3],
}

/// Angular rate from raw readings, with the first two derivatives of the rates; temperature in degrees Celsius.
#[allow(unused_variables)]
pub fn rate(w: &[f64; 3], dw: &[f64; 3], ddw: &[f64; 3], a: &[f64; 3], temperature_c: f64) -> [f64; 3] {
    let temperature_difference = temperature_c - {{ real(temperature) }};
    let x = [
{%- for terms in gyro %}
        {{ terms }},
{%- endfor %}
    ];
    [
{%- for row in K_omega %}
        {{ row }},
{%- endfor %}
    ]
}

/// Specific force at the origin from raw accelerations, their first two derivatives, angular rate and acceleration.
#[allow(unused_variables)]
pub fn force(
    a: &[f64; 3], da: &[f64; 3], dda: &[f64; 3], w: &[f64; 3], alpha: &[f64; 3], temperature_c: f64,
) -> [f64; 3] {
    const AXIS: [[f64; 3]; 3] = [
{%- for row in sensitive %}
        [{{ row }}],
{%- endfor %}
    ];
    const PLACE: [[f64; 3]; 3] = [
{%- for row in places %}
        [{{ row }}],
{%- endfor %}
    ];
    let temperature_difference = temperature_c - {{ real(temperature) }};
    let square = w[0] * w[0] + w[1] * w[1] + w[2] * w[2];
    let mut x = [
{%- for terms in accel %}
        {{ terms }},
{%- endfor %}
    ];
    for j in 0..3 {
        let r = &PLACE[j];
        let along = w[0] * r[0] + w[1] * r[1] + w[2] * r[2];
        x[j] -= AXIS[j][0] * (alpha[1] * r[2] - alpha[2] * r[1] + w[0] * along - square * r[0])
            + AXIS[j][1] * (alpha[2] * r[0] - alpha[0] * r[2] + w[1] * along - square * r[1])
            + AXIS[j][2] * (alpha[0] * r[1] - alpha[1] * r[0] + w[2] * along - square * r[2]);
    }
    [
{%- for row in K_a %}
        {{ row }},
{%- endfor %}
    ]
}

/// Weights of seven values in both derivatives, at the middle one, of the cubic closest to them.
fn weights(stamp_ns: &[i64]) -> ([f64; 7], [f64; 7]) {
    let span = (stamp_ns[6] - stamp_ns[0]) as f64 * 1e-9;
    let (mut slope, mut curvature, mut before) = ([0.0; 7], [0.0; 7], [0.0; 7]);
    let (mut p, mut at, mut at_before, mut size_before) = ([1.0; 7], [1.0, 0.0, 0.0], [0.0; 3], 1.0);
    let mut u = [0.0; 7];
    for k in 0..7 {
        u[k] = (stamp_ns[k] - stamp_ns[3]) as f64 * 1e-9 / span;
    }
    for degree in 0..4 {
        let (mut size, mut a) = (0.0, 0.0);
        for k in 0..7 {
            size += p[k] * p[k];
            a += u[k] * p[k] * p[k];
        }
        a /= size;
        let b = if degree > 0 { size / size_before } else { 0.0 };
        for k in 0..7 {
            let now: f64 = p[k];
            slope[k] += now * at[1] / size / span;
            curvature[k] += now * at[2] / size / (span * span);
            p[k] = (u[k] - a) * now - b * before[k];
            before[k] = now;
        }
        let next = [
            -a * at[0] - b * at_before[0],
            at[0] - a * at[1] - b * at_before[1],
            2.0 * at[1] - a * at[2] - b * at_before[2],
        ];
        at_before = at;
        at = next;
        size_before = size;
    }
    (slope, curvature)
}

/// First two derivatives, at the middle one, of the cubics closest to seven samples.
fn derivatives(stamp_ns: &[i64], x: &[[f64; 3]]) -> ([f64; 3], [f64; 3]) {
    let (slope, curvature) = weights(stamp_ns);
    let (mut dx, mut ddx) = ([0.0; 3], [0.0; 3]);
    for k in 0..7 {
        for j in 0..3 {
            dx[j] += slope[k] * x[k][j];
            ddx[j] += curvature[k] * x[k][j];
        }
    }
    (dx, ddx)
}

#[derive(Clone, Debug, Default)]
pub struct Stream {
    stamp_ns: [i64; 7 + LATER],
    rate: [[f64; 3]; 7],
    w: [[f64; 3]; 7 + LATER],
    a: [[f64; 3]; 7 + LATER],
    temperature: [f64; 7 + LATER],
    count: usize,
}

impl Stream {
    /// Take one sample; return the result of the one {{ late_by }} before it, once a run has enough of them.
    pub fn push(&mut self, stamp_ns: i64, w: &[f64; 3], a: &[f64; 3], temperature_c: f64) -> Option<Sample> {
        const LAST: usize = 6 + LATER;
        let step = stamp_ns - self.stamp_ns[LAST];
        if self.count > 0 && (step <= 0 || step > GAP_NS) {
            self.count = 0;
        }
        self.stamp_ns.rotate_left(1);
        self.rate.rotate_left(1);
        self.w.rotate_left(1);
        self.a.rotate_left(1);
        self.temperature.rotate_left(1);
        self.stamp_ns[LAST] = stamp_ns;
        self.w[LAST] = *w;
        self.a[LAST] = *a;
        self.temperature[LAST] = temperature_c;
        self.count = (self.count + 1).min(7 + 2 * LATER);
        let (mut dw, mut ddw) = ([0.0; 3], [0.0; 3]);
        if LATER > 0 {
            if self.count < 7 {
                return None;
            }
            (dw, ddw) = derivatives(&self.stamp_ns[LATER..], &self.w[LATER..]);
        }
        self.rate[6] = rate(&self.w[6], &dw, &ddw, &self.a[6], self.temperature[6]);
        if self.count < 7 + 2 * LATER {
            return None;
        }
        let (alpha, _) = derivatives(&self.stamp_ns, &self.rate);
        let (da, dda) = derivatives(&self.stamp_ns, &self.a);
        let found = force(&self.a[3], &da, &dda, &self.rate[3], &alpha, self.temperature[3]);
        Some(Sample { stamp_ns: self.stamp_ns[3], rate: self.rate[3], force: found })
    }
}
