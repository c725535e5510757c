/// What the filter is given of a cell, and what it records. Python's side is `kreisel._kernels.filter_arguments`.
#pragma once

#include "arrays.hpp"

namespace {

/// Where some numbers of the model come from: rows of the stored state, or, where -1, known values.
struct ParameterRows {
    Indices source;
    ConstNumbers known;
};

/// What a cell's filter needs to know besides state, readings and poses.
struct Model {
    IndexTable parts, tail;  // of the state, and of its last parts alone, which change between updates: manifold.hpp
    IndexTable sampled;        // parts of which sigma points are needed: all but the robot's errors, which enter linearly
    ConstNumbers weights;         // (5,): see sigma_points.hpp
    ParameterRows gyro, accel, around, robot;
    Index gyro_degrees;      // degrees of freedom of the gyros' parameters, which come first
    Index sensor_degrees;    // of the gyros' and the accelerometers' parameters
    Indices stored;          // (7,): where the parts below lie in the stored state, -1 where they are not in it
    IndexTable gyro_effects, accel_effects;  // (E, 3): see `effects_of` in process_model.hpp
    ConstNumbers gyro_applied, accel_applied;     // (e,)
    Index printed;           // the size effect as the paper prints it: see coefficients.hpp
    double level, down;      // Earth rate that a unit of north, and of its downward part, stands for, rad/s
    ConstNumbers noise;           // (6,): standard deviations
    ConstNumbers standstill;      // (2,): deviations of the reference's error at a standstill, position and orientation
    ConstNumbers coloured;        // (3,): time constant of the reference's coloured noise, s; deviations
    Indices walking;         // degrees of freedom that walk; the densities, and the rates at which what they were fades, 1/s
    ConstNumbers walk, fading;
    double noise_step;       // seconds of readings whose noise is taken together
    Index linear;            // linearisations of an update, at most; 0: sigma points in place of derivatives
    Indices varying;         // degrees of freedom whose covariance with all others is recorded: see `Record`
};

/// Places of parts in `Model::stored`.
ORDER(Stored, VELOCITY, POSITION, ATTITUDE, STANDSTILL_POSITION, STANDSTILL_ORIENTATION, PATH_POSITION, PATH_ORIENTATION);

/// Places of figures in `Model::noise`: reference on the path and at standstill, velocity at standstill.
ORDER(Noise, AT_POSITION, AT_ORIENTATION, JITTER_POSITION, JITTER_ORIENTATION, STANDSTILL_VELOCITY);

/// Places of numbers in `Model::coloured`.
ORDER(Coloured, COLOURED_TIME, COLOURED_POSITION, COLOURED_ORIENTATION);

/// Places of groups in `Model::gyro`, `Model::accel` and `Model::around`.
ORDER(Gyro, GYRO_CROSS_COUPLING = 0, GYRO_OFFSET = 9, GYRO_EFFECTS = 12);
ORDER(Accel, ACCEL_CROSS_COUPLING = 0, ACCEL_OFFSET = 9, LEVER_ARMS = 12, ACCEL_EFFECTS = 21);
ORDER(Around, ALIGNMENT = 0, NORTH = 4, GRAVITY = 6, TIME_OFFSET = 7, TIME_SKEW = 8, EARTH_DOWN = 9);

/// Updates in their order: samples, reference seconds, pose, regressor of the robot's errors.
struct Steps {
    Indices first, last;          // (u,)
    ConstNumbers tau;                  // (u,)
    ConstNumbers stamp;                // (u,): standard deviation of the poses' stamps, s
    Mask at_standstill;           // (u,)
    Mask new_standstill;          // (u,): whether a standstill begins
    ConstTable position, quaternion;   // (u, 3), (u, 4)
    Mask given;                   // (2,): whether positions and orientations are measured
    ConstStack regressor;              // (u, 6, e), e = 0 without a robot
    ConstTable about;                  // (u, a): the first numbers of the state that derivatives are taken about; else the mean
};

/// What updates leave. Measurement components are position, orientation and velocity, nan where there is no such measurement.
struct Record {
    Table mean, deviation;                        // (u, first numbers of the state), (u, k)
    WrittenMask used;                                    // (u,)
    Numbers nis, log_likelihood, turn_information;         // (u,)
    Table whitened, innovation, residual, noise_variance;  // (u, 9)
    Table passing;                                // (u, 6): velocity and rate of b
    Table late;                                   // (u, 2): error of the stamp, and its deviation
    Table correction, correction_variance;        // (u, 6): of velocity and attitude
    // What a small change of the state before an update does, empty where it is not asked for: to what moves, (u, c, n); to
    // the whitened measurement, and what that does to the state, (u, 9, n); whitened = whitening (9, 9) times measurement.
    Stack transition, design, gain, whitening;
    // Before an update: mean (u, size), and covariance of what varies with all, (u, s, n); empty where not asked for.
    Table before;
    Stack covariance;
};

/// What rejects an update.
struct Gate {
    ConstNumbers bounds;    // (10,): of the normalised innovation squared, for every number of degrees of freedom
    Index most;        // measurements rejected in a row after which to stop
    WrittenIndices rejected;  // (1,): measurements rejected in a row so far
};

/// Mean as stored, and factor of the covariance, transposed: upper triangular.
struct Gaussian {
    Numbers mean;  // (size,)
    Table upper;   // (n, n)
};

}  // namespace
