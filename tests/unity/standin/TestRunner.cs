// What the package's tests use of NUnit, which Unity's Test Runner brings.

using System;

namespace NUnit.Framework
{
    public class TestAttribute : Attribute { }

    public class SetUpAttribute : Attribute { }

    public static class Assert
    {
        static void Check(bool so, object expected, object found)
        {
            if (!so) throw new Exception("expected " + expected + ", found " + found);
        }

        public static void AreEqual(object expected, object found)
        {
            Check(Equals(expected, found), expected, found);
        }

        public static void AreEqual(double expected, double found, double within)
        {
            Check(Math.Abs(expected - found) <= within, expected, found);
        }

        public static void Throws<T>(Action act) where T : Exception
        {
            try { act(); }
            catch (T) { return; }
            throw new Exception("expected " + typeof(T).Name);
        }
    }
}
