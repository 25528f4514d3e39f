// Numbers as JsonUtility prints them: shortest digits by Grisu2 (F. Loitsch, Printing Floating-Point Numbers Quickly and
// Accurately with Integers, 2010) of the double that a float32 is. Its last digit is not always the nearest one, and real
// files of the editor show that; so this follows the algorithm, its two known shortcuts included.

using System;
using System.Collections.Generic;
using System.Globalization;
using System.Numerics;

namespace UnityEngine
{
    static class NumberText
    {
        const int Digits = 64;
        const ulong Hidden = 1UL << 52;

        /// <summary>A significand of 64 bits and a power of two.</summary>
        struct Scaled
        {
            public ulong F;
            public int E;

            public Scaled(ulong f, int e)
            {
                F = f;
                E = e;
            }

            public Scaled Normal()
            {
                Scaled found = this;
                while (found.F >> 63 == 0) found = new Scaled(found.F << 1, found.E - 1);
                return found;
            }

            public static Scaled operator *(Scaled a, Scaled b)
            {
                BigInteger product = (BigInteger)a.F * b.F;
                ulong high = (ulong)(product >> 64), low = (ulong)(product & ulong.MaxValue);
                return new Scaled(high + (low >> 63), a.E + b.E + 64);
            }
        }

        public static string Of(float value)
        {
            return Of((double)value);
        }

        public static string Of(double value)
        {
            if (double.IsNaN(value) || double.IsInfinity(value)) throw new ArgumentException("JSON has no such number");
            if (value == 0) return BitConverter.DoubleToInt64Bits(value) < 0 ? "-0.0" : "0.0";
            int exponent;
            string digits = Shortest(Math.Abs(value), out exponent);
            return (value < 0 ? "-" : "") + Laid(digits, exponent);
        }

        static string Shortest(double value, out int exponent)
        {
            long bits = BitConverter.DoubleToInt64Bits(value);
            int biased = (int)(bits >> 52) & 0x7ff;
            ulong fraction = (ulong)bits & (Hidden - 1);
            var v = biased != 0 ? new Scaled(fraction + Hidden, biased - 1075) : new Scaled(fraction, -1074);
            Scaled high = new Scaled((v.F << 1) + 1, v.E - 1).Normal();
            Scaled low = v.F == Hidden ? new Scaled((v.F << 2) - 1, v.E - 2) : new Scaled((v.F << 1) - 1, v.E - 1);
            low = new Scaled(low.F << (low.E - high.E), high.E);
            Scaled power = Power(high.E, out exponent);
            Scaled w = v.Normal() * power, top = high * power, bottom = low * power;
            return Generate(w, new Scaled(top.F - 1, top.E), top.F - 1 - (bottom.F + 1), ref exponent);
        }

        /// <summary>The power of ten, of every eighth, that brings a number near 2^-61, and minus its exponent.</summary>
        static Scaled Power(int e, out int exponent)
        {
            double estimate = (-61 - e) * 0.30102999566398114 + 347;
            int k = (int)estimate;
            if (estimate - k > 0) k++;
            int index = (k >> 3) + 1;
            exponent = 348 - (index << 3);
            return Ten(-exponent);
        }

        static readonly Dictionary<int, Scaled> Tens = new Dictionary<int, Scaled>();

        /// <summary>10^n with 64 bits, rounded to the nearest.</summary>
        static Scaled Ten(int n)
        {
            Scaled found;
            if (Tens.TryGetValue(n, out found)) return found;
            const int room = 1300; // bits that even 10^-348 leaves more than 64 of
            BigInteger whole = n >= 0 ? BigInteger.Pow(10, n) << room : (BigInteger.One << room) / BigInteger.Pow(10, -n);
            int length = 0;
            for (BigInteger rest = whole; rest > 0; rest >>= 1) length++;
            int drop = length - Digits;
            BigInteger rounded = (whole + (BigInteger.One << (drop - 1))) >> drop;
            return Tens[n] = new Scaled((ulong)rounded, drop - room);
        }

        static string Generate(Scaled w, Scaled top, ulong delta, ref int exponent)
        {
            int shift = -top.E;
            ulong one = 1UL << shift, distance = top.F - w.F, part = top.F & (one - 1);
            var whole = (uint)(top.F >> shift);
            int left = whole.ToString(CultureInfo.InvariantCulture).Length;
            var digits = new List<char>();
            while (left > 0)
            {
                uint ten = (uint)Math.Pow(10, left - 1);
                Push(digits, whole / ten);
                whole %= ten;
                left--;
                ulong rest = ((ulong)whole << shift) + part;
                if (rest > delta) continue;
                exponent += left;
                return Rounded(digits, delta, rest, (ulong)ten << shift, distance);
            }
            while (true)
            {
                part *= 10;
                delta *= 10;
                Push(digits, (uint)(part >> shift));
                part &= one - 1;
                left--;
                if (part >= delta) continue;
                exponent += left;
                // beyond nine places the distance is taken for 0, so that the last digit is not corrected
                ulong scaled = -left < 9 ? distance * (ulong)Math.Pow(10, -left) : 0;
                return Rounded(digits, delta, part, one, scaled);
            }
        }

        static void Push(List<char> digits, uint digit)
        {
            if (digit > 0 || digits.Count > 0) digits.Add((char)('0' + digit));
        }

        static string Rounded(List<char> digits, ulong delta, ulong rest, ulong ten, ulong distance)
        {
            while (rest < distance && delta - rest >= ten
                && (rest + ten < distance || distance - rest > rest + ten - distance))
            {
                digits[digits.Count - 1]--;
                rest += ten;
            }
            return new string(digits.ToArray());
        }

        /// <summary>Digits times a power of ten, with a point where that is short.</summary>
        static string Laid(string digits, int exponent)
        {
            int point = digits.Length + exponent;
            if (exponent >= 0 && point <= 21) return digits + new string('0', exponent) + ".0";
            if (point > 0 && point <= 21) return digits.Substring(0, point) + "." + digits.Substring(point);
            if (point > -6 && point <= 0) return "0." + new string('0', -point) + digits;
            string rest = digits.Length == 1 ? "" : "." + digits.Substring(1);
            return digits[0] + rest + "e" + (point - 1).ToString(CultureInfo.InvariantCulture);
        }
    }
}
