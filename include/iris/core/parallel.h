// Deterministic parallel loops: fixed chunks, so that no result depends on the number of threads.
#pragma once

#include <functional>

namespace iris {

// Calls body(chunk_begin, chunk_end) for consecutive chunks of `grain` indices that cover [begin, end).
// The chunks depend on `grain` alone; which thread runs which chunk does not matter, since each chunk must write
// only what belongs to its own indices. Reductions: one partial result a chunk, combined afterwards in chunk order.
// Exceptions thrown by body are passed on.
void parallel_chunks(int begin, int end, int grain, const std::function<void(int, int)>& body);

// Runs `work` so that everything parallel inside it uses at most `threads` threads (>= 1).
void with_threads(int threads, const std::function<void()>& work);

// Number of processors of this machine, >= 1.
int available_threads();

}  // namespace iris
