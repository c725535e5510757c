/// What crosses the border to Python, in words: `_kernels.compiled` compares it with its own before it calls anything.
///
/// A line for each structure, `struct <name> <size>: <field> <offset> <type>, …`, one for each order of numbers in an array,
/// `order <name>: <first>, <second>, …`, and one for each number the library is made for, `count <name>: <value>`. An order is
/// written here alone; Python reads it.
#pragma once

#include <cstddef>
#include <string>
#include <type_traits>

#include "chain.hpp"
#include "filter.hpp"
#include "node_elimination.hpp"
#include "rotation_fit.hpp"

namespace {

/// What Python calls a type: it has one view for what is read and what is written.
template <class T> struct Named;
#define NAMED_AS(type, python) template <> struct Named<type> { static constexpr const char *name = #python; };
#define NAMED(type) NAMED_AS(type, type)
NAMED(double) NAMED(Index) NAMED(Numbers) NAMED(Table) NAMED(Stack) NAMED(Indices) NAMED(IndexTable) NAMED(Mask)
NAMED(ParameterRows) NAMED(Model) NAMED(Samples) NAMED(Steps) NAMED(Record) NAMED(Gate) NAMED(Gaussian)
NAMED(Chain) NAMED(ChainRows) NAMED(RateSignal)
NAMED_AS(ConstNumbers, Numbers) NAMED_AS(ConstTable, Table) NAMED_AS(ConstStack, Stack)
NAMED_AS(WrittenIndices, Indices) NAMED_AS(WrittenMask, Mask)
#undef NAMED
#undef NAMED_AS

/// Text that grows by the fields of one structure after another.
struct Layout {
    std::string text;

    void begin(const char *name, std::size_t size) { text += std::string("struct ") + name + " " + std::to_string(size) + ":"; }
    void field(const char *name, std::size_t offset, const char *type) {
        text += std::string(" ") + name + " " + std::to_string(offset) + " " + type + ",";
    }
    void end() { text.back() = '\n'; }
    void count(const char *name, Index value) { text += std::string("count ") + name + ": " + std::to_string(value) + "\n"; }
    void order(const char *name, const char *numbers) { text += std::string("order ") + name + ": " + numbers + "\n"; }
};

#define BEGIN(type) using T = type; layout.begin(#type, sizeof(T))
#define FIELD(of) layout.field(#of, offsetof(T, of), Named<decltype(T::of)>::name)

inline void cell_layout(Layout &layout) {
    {
        BEGIN(ParameterRows);
        FIELD(source); FIELD(known);
        layout.end();
    }
    {
        BEGIN(Model);
        FIELD(parts); FIELD(tail); FIELD(sampled); FIELD(weights); FIELD(gyro); FIELD(accel); FIELD(around); FIELD(robot);
        FIELD(gyro_degrees); FIELD(sensor_degrees); FIELD(stored); FIELD(gyro_effects); FIELD(accel_effects);
        FIELD(gyro_applied); FIELD(accel_applied); FIELD(printed); FIELD(level); FIELD(down); FIELD(noise);
        FIELD(standstill); FIELD(coloured); FIELD(walking); FIELD(walk); FIELD(fading); FIELD(noise_step); FIELD(linear);
        FIELD(varying);
        layout.end();
    }
    {
        BEGIN(Samples);
        FIELD(stamps); FIELD(base); FIELD(single); FIELD(twice); FIELD(rates); FIELD(slopes); FIELD(integrals);
        FIELD(forces); FIELD(noise); FIELD(usual);
        layout.end();
    }
    {
        BEGIN(Steps);
        FIELD(first); FIELD(last); FIELD(tau); FIELD(stamp); FIELD(at_standstill); FIELD(new_standstill); FIELD(position);
        FIELD(quaternion); FIELD(given); FIELD(regressor); FIELD(about);
        layout.end();
    }
    {
        BEGIN(Record);
        FIELD(mean); FIELD(deviation); FIELD(used); FIELD(nis); FIELD(log_likelihood); FIELD(turn_information);
        FIELD(whitened); FIELD(innovation); FIELD(residual); FIELD(noise_variance); FIELD(passing); FIELD(late); FIELD(correction);
        FIELD(correction_variance); FIELD(transition); FIELD(design); FIELD(gain); FIELD(whitening); FIELD(before); FIELD(covariance);
        layout.end();
    }
    {
        BEGIN(Gate);
        FIELD(bounds); FIELD(most); FIELD(rejected);
        layout.end();
    }
    {
        BEGIN(Gaussian);
        FIELD(mean); FIELD(upper);
        layout.end();
    }
}

inline void other_layout(Layout &layout) {
    {
        BEGIN(Chain);
        FIELD(rotations); FIELD(translations); FIELD(axes); FIELD(turning); FIELD(bodies);
        layout.end();
    }
    {
        BEGIN(ChainRows);
        FIELD(residual); FIELD(node); FIELD(next); FIELD(of_node); FIELD(of_next); FIELD(of_parameters);
        layout.end();
    }
    {
        BEGIN(RateSignal);
        FIELD(stamps); FIELD(rates); FIELD(smooth); FIELD(integral);
        layout.end();
    }
}

#undef FIELD
#undef BEGIN

/// All of it.
inline const std::string &layout_text() {
    static const std::string text = [] {
        Layout layout;
        cell_layout(layout);
        other_layout(layout);
        layout.count("lanes", LANES);
        layout.count("stencil", STENCIL);
        layout.count("rates", RATES);
        layout.count("measured", MAX_MEASURED);
        layout.count("joints", MAX_JOINTS);
        layout.count("node", NODE);
        layout.order("Stored", Stored_order);
        layout.order("Noise", Noise_order);
        layout.order("Coloured", Coloured_order);
        layout.order("Gyro", Gyro_order);
        layout.order("Accel", Accel_order);
        layout.order("Around", Around_order);
        layout.order("Weights", Weights_order);
        return layout.text;
    }();
    return text;
}

}  // namespace
