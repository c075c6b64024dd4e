#include "iris/core/parallel.h"

#include <tbb/blocked_range.h>
#include <tbb/global_control.h>
#include <tbb/info.h>
#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <algorithm>

#include "iris/core/error.h"

namespace iris {

void parallel_chunks(int begin, int end, int grain, const std::function<void(int, int)>& body) {
  IRIS_CHECK(grain > 0);
  if (begin >= end) return;
  const int chunks = (end - begin + grain - 1) / grain;
  tbb::parallel_for(
      tbb::blocked_range<int>(0, chunks, 1),
      [&](const tbb::blocked_range<int>& range) {
        for (int chunk = range.begin(); chunk < range.end(); ++chunk) {
          const int from = begin + chunk * grain;
          body(from, std::min(from + grain, end));
        }
      },
      tbb::simple_partitioner());
}

void with_threads(int threads, const std::function<void()>& work) {
  IRIS_CHECK(threads >= 1);
  // Without it the library refuses more threads than processors, and says so on the terminal.
  const tbb::global_control at_most(tbb::global_control::max_allowed_parallelism,
                                    static_cast<size_t>(std::max(threads, available_threads())));
  tbb::task_arena arena(threads);
  arena.execute(work);
}

int available_threads() { return std::max(1, tbb::info::default_concurrency()); }

}  // namespace iris
