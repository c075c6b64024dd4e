#include "iris/loop/retrieval.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>
#include <set>

#include "iris/core/parallel.h"

namespace iris::loop {
namespace {

// Descriptors of a made-up walk: a place has its own features, neighbouring places share half of them; every sight of a
// feature has a few wrong bits, and a fifth of a view's features belongs to nothing.
class Walk {
 public:
  Walk(int places, int features) : features_(features), random_(7) {
    own_ = cv::Mat1b((places + 1) * features / 2, kDescriptorBytes);
    for (int r = 0; r < own_.rows; ++r)
      for (int b = 0; b < own_.cols; ++b) own_(r, b) = static_cast<uint8_t>(random_());
  }

  cv::Mat1b view(int place) {
    cv::Mat1b result(features_, kDescriptorBytes);
    for (int r = 0; r < features_; ++r) {
      const int from = place * features_ / 2 + r;
      for (int b = 0; b < kDescriptorBytes; ++b) {
        result(r, b) = r % 5 == 0 ? static_cast<uint8_t>(random_()) : own_(from, b);
      }
      for (int wrong = 0; wrong < 8; ++wrong) {
        const unsigned bit = random_() % (8 * kDescriptorBytes);
        result(r, static_cast<int>(bit / 8)) ^= static_cast<uint8_t>(1u << bit % 8);
      }
    }
    return result;
  }

 private:
  int features_;
  std::mt19937 random_;
  cv::Mat1b own_;
};

ViewIndex index_of(const std::vector<cv::Mat1b>& views) {
  ViewIndex index;
  index.train(views);
  for (const cv::Mat1b& view : views) index.add(view);
  index.finish();
  return index;
}

TEST(Vocabulary, GivesEqualDescriptorsOneWordAndDifferentOnesSeveral) {
  Walk walk(20, 200);
  std::vector<cv::Mat1b> views;
  for (int place = 0; place < 20; ++place) views.push_back(walk.view(place));
  const Vocabulary vocabulary(views);
  EXPECT_GT(vocabulary.words(), 100);
  EXPECT_LE(vocabulary.words(), 4000);
  std::set<int> used;
  for (const cv::Mat1b& view : views) {
    for (int r = 0; r < view.rows; ++r) {
      const int word = vocabulary.word(view[r]);
      ASSERT_TRUE(word >= 0 && word < vocabulary.words());
      const cv::Mat1b copy = view.row(r).clone();
      ASSERT_EQ(vocabulary.word(copy[0]), word);
      used.insert(word);
    }
  }
  EXPECT_EQ(static_cast<int>(used.size()), vocabulary.words());  // it was trained on these
}

TEST(Vocabulary, OfNothingOrOfEqualDescriptorsHasOneWord) {
  EXPECT_EQ(Vocabulary().words(), 1);
  EXPECT_EQ(Vocabulary(std::vector<cv::Mat1b>(1)).words(), 1);
  const Vocabulary equal(std::vector<cv::Mat1b>{cv::Mat1b(100, kDescriptorBytes, uint8_t{7})});
  EXPECT_EQ(equal.words(), 1);
  const cv::Mat1b any(1, kDescriptorBytes, uint8_t{9});
  EXPECT_EQ(equal.word(any[0]), 0);
}

TEST(ViewIndex, ScoresAreCosines) {
  Walk walk(10, 100);
  std::vector<cv::Mat1b> views;
  for (int place = 0; place < 10; ++place) views.push_back(walk.view(place));
  views.push_back(views[3].clone());
  views.push_back(cv::Mat1b());  // a dark view
  const ViewIndex index = index_of(views);
  EXPECT_NEAR(index.score(3, 3), 1, 1e-5);
  EXPECT_NEAR(index.score(3, 10), 1, 1e-5);
  EXPECT_NEAR(index.score(2, 3), index.score(3, 2), 1e-12);
  const std::vector<ScoredView> found = index.query(3, 4);
  ASSERT_GE(found.size(), 3u);
  EXPECT_EQ(found[0].index, 10);
  EXPECT_THAT((std::set<int>{found[1].index, found[2].index}), ::testing::ElementsAre(2, 4));
  for (const ScoredView& f : found) EXPECT_NEAR(f.score, index.score(3, f.index), 1e-5);
  EXPECT_TRUE(index.query(11, 5).empty());
}

// 10 000 views of 5 000 places, each seen twice. The time grows with the number of views: at 400 descriptors a view all
// of it took 8.5 s of one processor and 72 MB beside the descriptors; here it is 60 descriptors.
TEST(ViewIndex, FindsTheSecondSightOfAPlaceAmongTenThousandViews) {
  constexpr int kPlaces = 5000;
  Walk walk(kPlaces, 60);
  std::vector<cv::Mat1b> views;
  for (int v = 0; v < 2 * kPlaces; ++v) views.push_back(walk.view(v % kPlaces));
  const ViewIndex index = index_of(views);
  std::vector<std::vector<ScoredView>> found(views.size());
  const auto all_queries = [&] {
    parallel_chunks(0, static_cast<int>(views.size()), 8, [&](int from, int to) {
      for (int v = from; v < to; ++v) found[v] = index.query(v, 5);
    });
  };
  with_threads(2, all_queries);
  int among_first_five = 0;
  for (int v = 0; v < 2 * kPlaces; ++v) {
    const int other = (v + kPlaces) % (2 * kPlaces);
    for (const ScoredView& f : found[v]) among_first_five += f.index == other;
  }
  EXPECT_GT(among_first_five, 0.95 * 2 * kPlaces);
}

TEST(ViewIndex, IsTheSameForAnyNumberOfThreads) {
  Walk walk(200, 100);
  std::vector<cv::Mat1b> views;
  for (int v = 0; v < 300; ++v) views.push_back(walk.view(v % 200));
  std::vector<std::vector<ScoredView>> answers[2];
  for (const int threads : {1, 3}) {
    with_threads(threads, [&] {
      const ViewIndex index = index_of(views);
      for (int v = 0; v < 300; ++v) answers[threads / 2].push_back(index.query(v, 10));
    });
  }
  for (int v = 0; v < 300; ++v) {
    ASSERT_EQ(answers[0][v].size(), answers[1][v].size());
    for (size_t k = 0; k < answers[0][v].size(); ++k) {
      EXPECT_EQ(answers[0][v][k].index, answers[1][v][k].index);
      EXPECT_EQ(answers[0][v][k].score, answers[1][v][k].score);
    }
  }
}

}  // namespace
}  // namespace iris::loop
