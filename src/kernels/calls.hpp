/// What a function needs that Python calls: its name, its status, its arrays with padded rows.
#pragma once

#include "exported.hpp"
#include "workspace.hpp"

#define JOIN(a, b) a##b
#define JOINED(a, b) JOIN(a, b)
#define KREISEL(name) JOINED(JOINED(kreisel_, VARIANT), JOINED(_, name))

namespace {

enum Status { DONE, NO_MEMORY, MISMATCH };

template <class Function>
int guarded(Function work) {
    try {
        work();
        return DONE;
    } catch (const OutOfMemory &) {
        return NO_MEMORY;
    } catch (const Mismatch &) {
        return MISMATCH;
    }
}

/// A copy with padded rows, for work that wants them.
Columns copied(Table table, Workspace &memory) {
    const Columns out = memory.zeros(table.rows, table.columns);
    copy(table, out, table.rows, table.columns);
    return out;
}

Columns columns(Table table) { return {{table.data, table.rows, table.columns}}; }
Columns columns(Stack stack) { return {{stack.data, stack.tables * stack.rows, stack.columns}}; }

}  // namespace
