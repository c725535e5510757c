/// Tables of numbers, as text: rows of decimal numbers between commas.
#pragma once

#include <cmath>
#include <cstdio>

#include "arrays.hpp"

namespace {

/// Bytes of a text.
struct Bytes {
    const std::uint8_t *data;
    Index count;

    std::uint8_t operator[](Index i) const { return data[i]; }
};

struct WrittenBytes {
    std::uint8_t *data;
    Index count;
};

constexpr double POWERS_OF_TEN[] = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
                                    1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};

constexpr int DIGITS = 19;  ///< decimal digits that always fit 64 bits

using Wide = unsigned __int128;

/// A power of ten for divisions: shifted to the left until its top bit is set, and its reciprocal.
struct Divisor {
    std::uint64_t number, reciprocal;
    int shift;

    constexpr Divisor(int exponent = 0) : number(1), reciprocal(0), shift(0) {
        while (exponent-- > 0) number *= 10;
        while (!(number >> 63)) number <<= 1, shift++;
        reciprocal = static_cast<std::uint64_t>(~Wide(0) / number - (Wide(1) << 64));
    }

    /// The quotient of dividend 2^63 and the number, for any 64-bit dividend, and whether something is left.
    ///
    /// Moeller and Granlund (2011), algorithm 4.
    std::uint64_t quotient(std::uint64_t dividend, bool &left) const {
        const std::uint64_t high = dividend >> 1, low = dividend << 63;
        const Wide product = Wide(reciprocal) * high + ((Wide(high) << 64) | low);
        std::uint64_t q = static_cast<std::uint64_t>(product >> 64) + 1, r = low - q * number;
        if (r > static_cast<std::uint64_t>(product)) q--, r += number;
        if (r >= number) q++, r -= number;
        left = r != 0;
        return q;
    }
};

struct Divisors {
    Divisor of[DIGITS + 1];

    constexpr Divisors() : of() {
        for (int i = 0; i <= DIGITS; i++) of[i] = Divisor(i);
    }
};

constexpr Divisors DIVISORS;

/// The number m 2^shift, rounded to nearest and even; `rest` is whether something is left below m. m is not zero, and the
/// result is a normal number.
inline double rounded(std::uint64_t m, int shift, bool rest) {
    const int below = 11 - __builtin_clzll(m);
    if (below > 0) {
        const std::uint64_t half = std::uint64_t(1) << (below - 1), cut = m & (2 * half - 1);
        m >>= below;
        m += cut > half || (cut == half && (rest || (m & 1)));
        shift += below;
    }
    const std::uint64_t bits = static_cast<std::uint64_t>(shift + 1023) << 52;
    double power;
    std::memcpy(&power, &bits, sizeof power);
    return static_cast<double>(m) * power;
}

/// Write digits 10^exponent, correctly rounded, and return whether that was possible; exponent from -38 on.
inline bool decimal(std::uint64_t digits, int exponent, double &number) {
    constexpr std::uint64_t EXACT = std::uint64_t(1) << 53;
    if (digits <= EXACT && -23 < exponent && exponent < 23) {
        // both are numbers of 53 bits, and one operation rounds once
        const double whole = static_cast<double>(digits);
        number = exponent < 0 ? whole / POWERS_OF_TEN[-exponent] : whole * POWERS_OF_TEN[exponent];
        return true;
    }
    if (exponent > 0) return false;
    const int up = __builtin_clzll(digits);
    const Divisor &first = DIVISORS.of[exponent < -DIGITS ? DIGITS : -exponent];
    bool rest;
    const std::uint64_t quotient = first.quotient(digits << up, rest);
    const int shift = first.shift - 63 - up;
    if (exponent >= -DIGITS) {
        number = rounded(quotient, shift, rest);
        return true;
    }
    // The rest of the first division is not carried on: both numbers that it may be have to give the same.
    const Divisor &second = DIVISORS.of[-exponent - DIGITS];
    const int more = __builtin_clzll(quotient + 1);
    const std::uint64_t low = second.quotient(quotient << more, rest), high = second.quotient((quotient + 1) << more, rest);
    number = rounded(low, shift + second.shift - 63 - more, true);
    return number == rounded(high, shift + second.shift - 63 - more, true);
}

/// What a cell holds: a number, or something else that a slower reader has to look at.
enum class Cell { NUMBER, OTHER };

/// Read digits, a point and an exponent from `at` on, and move `at` after them.
inline Cell read_number(Bytes text, Index &at, double &number) {
    const bool negative = at < text.count && text[at] == '-';
    if (at < text.count && (text[at] == '-' || text[at] == '+')) at++;
    std::uint64_t digits = 0;
    int count = 0, exponent = 0;
    bool some = false;
    for (bool point = false; at < text.count; at++) {
        const unsigned digit = text[at] - unsigned('0');
        if (digit < 10) {
            some = true;
            count += digits || digit ? 1 : 0;
            digits = 10 * digits + digit;
            exponent -= point ? 1 : 0;
            if (count > DIGITS) return Cell::OTHER;
        } else if (text[at] == '.' && !point) {
            point = true;
        } else {
            break;
        }
    }
    if (!some) return Cell::OTHER;
    if (at < text.count && (text[at] == 'e' || text[at] == 'E')) {
        at++;
        const bool down = at < text.count && text[at] == '-';
        if (at < text.count && (text[at] == '-' || text[at] == '+')) at++;
        int power = 0, length = 0;
        for (; at < text.count && text[at] - unsigned('0') < 10 && length < 4; at++, length++) power = 10 * power + (text[at] - '0');
        if (length == 0 || length == 4) return Cell::OTHER;
        exponent += down ? -power : power;
    }
    number = 0.0;
    if (digits && (exponent < -2 * DIGITS || !decimal(digits, exponent, number))) return Cell::OTHER;
    number = negative ? -number : number;
    return Cell::NUMBER;
}

/// Read a whole number of at most 18 digits.
inline Cell read_whole(Bytes text, Index &at, Index &number) {
    const bool negative = at < text.count && text[at] == '-';
    at += negative ? 1 : 0;
    const Index begin = at;
    number = 0;
    for (; at < text.count && text[at] - unsigned('0') < 10 && at - begin < DIGITS; at++) number = 10 * number + (text[at] - '0');
    if (at == begin || at - begin == DIGITS) return Cell::OTHER;
    number = negative ? -number : number;
    return Cell::NUMBER;
}

/// Cells that were left out: row, column, and where their text begins and ends.
struct OddCells {
    Index *places;  // (room, 4)
    Index room, count = 0;
};

/// Read rows of numbers into values (at least as many rows as lines, columns), the first column as whole numbers into
/// `stamps` where it has as many. Empty lines are left out.
///
/// Returns how many rows there are, or -1 if the table is not a regular one: a row of another length, a comment, a stamp
/// that is not a plain number, too many odd cells.
inline Index read_rows(Bytes text, WrittenIndices stamps, Table values, OddCells &odd) {
    const bool whole = stamps.count > 0;
    Index row = 0, at = 0;
    const auto skip_blanks = [&] {
        while (at < text.count && (text[at] == ' ' || text[at] == '\t')) at++;
    };
    while (at < text.count) {
        if (text[at] == '\n') {
            at++;
            continue;
        }
        if (row == values.rows) return -1;
        for (Index column = 0; column < values.columns; column++) {
            skip_blanks();
            const Index begin = at;
            double number = 0.0;
            Index stamp = 0;
            Cell cell = column == 0 && whole ? read_whole(text, at, stamp) : read_number(text, at, number);
            skip_blanks();
            const std::uint8_t end = column + 1 < values.columns ? ',' : '\n';
            const bool ended = at < text.count ? text[at] == end : end == '\n';
            if (cell == Cell::OTHER || !ended) {
                if (odd.count == odd.room || (column == 0 && whole)) return -1;
                while (at < text.count && text[at] != ',' && text[at] != '\n' && text[at] != '#') at++;
                if (at < text.count ? text[at] != end : end != '\n') return -1;
                Index *place = odd.places + 4 * odd.count++;
                place[0] = row, place[1] = column, place[2] = begin, place[3] = at;
            }
            if (column == 0 && whole) stamps[row] = stamp;
            values(row, column) = number;
            at++;
        }
        row++;
    }
    return row;
}

constexpr int WRITTEN = 9;  ///< significant digits that are written

/// A number's first digits, as a whole number from 1e8 on, and the power of ten of the first one.
struct Digits {
    std::uint64_t whole;
    int exponent;
};

/// The digits of a finite number above zero, rounded to nearest and even.
inline Digits digits_of(double number) {
    constexpr double FIRST = 1e8;
    constexpr double UNSURE = 1e-6;  // the product is right to 1.2e-7
    constexpr int LAST_EXACT = 22;   // powers of ten up to here are numbers of 53 bits
    int exponent = static_cast<int>(std::floor(std::log10(number)));
    const auto scaled = [&] {
        const int up = WRITTEN - 1 - exponent;
        return up < 0 ? number / POWERS_OF_TEN[-up] : number * POWERS_OF_TEN[up];
    };
    if (std::abs(WRITTEN - 1 - exponent) < LAST_EXACT) {
        double whole = scaled();
        if (whole < FIRST) exponent--, whole = scaled();
        if (whole >= 10.0 * FIRST) exponent++, whole = scaled();
        const std::uint64_t below = static_cast<std::uint64_t>(whole);
        const double rest = whole - static_cast<double>(below);
        if (whole >= FIRST && std::abs(rest - 0.5) > UNSURE) {
            const std::uint64_t rounded = below + (rest > 0.5 ? 1 : 0);
            return rounded < 1000000000u ? Digits{rounded, exponent} : Digits{100000000u, exponent + 1};
        }
    }
    char text[32];
    std::snprintf(text, sizeof text, "%.*e", WRITTEN - 1, number);
    Digits found = {0, 0};
    const char *at = text;
    for (; *at != 'e'; at++) {
        if (*at >= '0' && *at <= '9') found.whole = 10 * found.whole + static_cast<std::uint64_t>(*at - '0');
    }
    const bool down = at[1] == '-';
    for (at += 2; *at; at++) found.exponent = 10 * found.exponent + (*at - '0');
    if (down) found.exponent = -found.exponent;
    return found;
}

/// Write a number as the format %.9g does, and return where its text ends.
inline std::uint8_t *write_number(double number, std::uint8_t *out) {
    const auto words = [&out](const char *text) {
        while (*text) *out++ = static_cast<std::uint8_t>(*text++);
        return out;
    };
    if (std::isnan(number)) return words("nan");
    if (std::signbit(number)) *out++ = '-';
    if (std::isinf(number)) return words("inf");
    if (number == 0.0) return words("0");
    Digits found = digits_of(std::abs(number));
    const int exponent = found.exponent;
    std::uint8_t digits[WRITTEN];
    int count = WRITTEN;
    for (int i = WRITTEN - 1; i >= 0; i--) digits[i] = static_cast<std::uint8_t>('0' + found.whole % 10), found.whole /= 10;
    while (count > 1 && digits[count - 1] == '0') count--;
    if (exponent >= -4 && exponent < 0) {
        words("0.");
        for (int i = -1; i > exponent; i--) *out++ = '0';
        for (int i = 0; i < count; i++) *out++ = digits[i];
        return out;
    }
    const bool powers = exponent < -4 || exponent >= WRITTEN;
    const int before = powers ? 1 : exponent + 1;
    for (int i = 0; i < before; i++) *out++ = i < count ? digits[i] : '0';
    if (count > before) *out++ = '.';
    for (int i = before; i < count; i++) *out++ = digits[i];
    if (powers) {
        const int size = exponent < 0 ? -exponent : exponent;
        words(exponent < 0 ? "e-" : "e+");
        if (size >= 100) *out++ = static_cast<std::uint8_t>('0' + size / 100);
        *out++ = static_cast<std::uint8_t>('0' + size / 10 % 10);
        *out++ = static_cast<std::uint8_t>('0' + size % 10);
    }
    return out;
}

/// Write rows of numbers between commas into a text with room for 17 characters a number: a sign, a point, the digits, an
/// exponent and what ends it. Returns how many characters there are.
inline Index write_rows(ConstTable values, WrittenBytes text) {
    std::uint8_t *at = text.data;
    for (Index row = 0; row < values.rows; row++) {
        for (Index column = 0; column < values.columns; column++) {
            at = write_number(values(row, column), at);
            *at++ = column + 1 < values.columns ? ',' : '\n';
        }
    }
    return at - text.data;
}

}  // namespace
