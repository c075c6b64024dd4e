#include "iris/session/pairing.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iris/core/atomic_file.h"
#include "iris/core/error.h"
#include "support/temporary_folder.h"

namespace iris::session {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Pair;

TEST(Names, StampsHaveSixteenDigitsOrSeconds) {
  EXPECT_EQ(stamp_in_name("1403636584763555584"), 1403636584763555584);
  EXPECT_EQ(stamp_in_name("0000000000000050"), 50);
  EXPECT_EQ(stamp_in_name("1403636584.763555584"), 1403636584763555584);
  EXPECT_EQ(stamp_in_name("1403636584.5"), 1403636584500000000);
  EXPECT_EQ(stamp_in_name("000012"), std::nullopt);
  EXPECT_EQ(stamp_in_name("frame1403636584763555584"), std::nullopt);
  EXPECT_EQ(stamp_in_name("99999999999999999999999"), std::nullopt);  // more than 64 bits
}

TEST(Names, FrameNumberIsTheLastGroupOfDigits) {
  EXPECT_EQ(number_in_name("000012"), 12);
  EXPECT_EQ(number_in_name("frame0007"), 7);
  EXPECT_EQ(number_in_name("cam0_left_0031_raw"), 31);
  EXPECT_EQ(number_in_name("left"), std::nullopt);
}

TEST(PairByStamp, MissingImagesAndJitter) {
  // Right lacks 200 and has one that nobody wants at 450; jitter of up to 9.
  const Pairing p = pair_by_stamp({0, 100, 200, 300, 400}, {3, 109, 295, 400, 450}, 50);
  EXPECT_THAT(p.pairs, ElementsAre(Pair(0, 0), Pair(1, 1), Pair(3, 2), Pair(4, 3)));
  EXPECT_THAT(p.unpaired_left, ElementsAre(2));
  EXPECT_THAT(p.unpaired_right, ElementsAre(4));
}

TEST(PairByStamp, EveryImageOnceAndInOrder) {
  // Both lefts are nearest to the one right: the nearer one gets it.
  const Pairing p = pair_by_stamp({0, 40}, {30}, 50);
  EXPECT_THAT(p.pairs, ElementsAre(Pair(1, 0)));
  EXPECT_THAT(p.unpaired_left, ElementsAre(0));
}

TEST(PairByStamp, LimitIsInclusiveAndEmptySidesAreFine) {
  EXPECT_THAT(pair_by_stamp({0}, {50}, 50).pairs, ElementsAre(Pair(0, 0)));
  EXPECT_THAT(pair_by_stamp({0}, {51}, 50).pairs, IsEmpty());
  EXPECT_THAT(pair_by_stamp({}, {1, 2}, 50).unpaired_right, ElementsAre(0, 1));
  EXPECT_THAT(pair_by_stamp({1, 2}, {}, 50).unpaired_left, ElementsAre(0, 1));
}

// Half the rate on the right: every second left image has a partner.
TEST(PairByStamp, DifferentRates) {
  const Pairing p = pair_by_stamp({0, 100, 200, 300, 400}, {1, 201, 401}, 50);
  EXPECT_THAT(p.pairs, ElementsAre(Pair(0, 0), Pair(2, 1), Pair(4, 2)));
}

TEST(PairByNumber, OnlyEqualNumbers) {
  const Pairing p = pair_by_number({1, 2, 4, 5}, {2, 3, 4});
  EXPECT_THAT(p.pairs, ElementsAre(Pair(1, 0), Pair(2, 2)));
  EXPECT_THAT(p.unpaired_left, ElementsAre(0, 3));
  EXPECT_THAT(p.unpaired_right, ElementsAre(1));
}

TEST(MedianPeriod, IgnoresGaps) {
  EXPECT_EQ(median_period({0, 100, 201, 300, 5000, 5100}), 100);
  EXPECT_EQ(median_period({7}), 0);
}

TEST(Times, SecondsNanosecondsAndNumbers) {
  iris::testing::TemporaryFolder folder;
  const auto file = folder.path() / "times.txt";
  write_file(file, "0.000000e+00\n1.036224e-01\r\n\n0.25 # late\n");
  EXPECT_THAT(read_times(file), ElementsAre(Pair(0, 0), Pair(1, 103622400), Pair(2, 250000000)));
  write_file(file, "1403636584763555584\n1403636584863555584\n");
  EXPECT_THAT(read_times(file), ElementsAre(Pair(0, 1403636584763555584), Pair(1, 1403636584863555584)));
  write_file(file, "# number, seconds\n10, 1.5\n12, 1.75\n");
  EXPECT_THAT(read_times(file), ElementsAre(Pair(10, 1500000000), Pair(12, 1750000000)));

  const auto error_of = [&](const std::string& text) -> std::string {
    write_file(file, text);
    try {
      read_times(file);
    } catch (const InputError& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_THAT(error_of("0\n0.1\nsoon\n"), HasSubstr("line 3 is no time"));
  EXPECT_THAT(error_of("0\nnan\n"), HasSubstr("line 2 is no time"));
  EXPECT_THAT(error_of("0\n0.2\n0.1\n"), HasSubstr("line 3: the time does not come after"));
}

}  // namespace
}  // namespace iris::session
