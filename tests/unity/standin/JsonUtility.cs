// JsonUtility by Unity's rules of serialisation (Manual, Script serialization): fields that are public or have
// SerializeField, neither static, const, readonly nor NonSerialized, those of base classes first; numbers, texts, enums as
// numbers, vectors, classes with Serializable, arrays and lists of these, but not of lists. No properties, dictionaries or
// nullable values. A class that is null is written with its default values, a text as "", a list as []; nothing is deeper
// than 10. Reading leaves fields alone that the text does not have, and ignores what has no field.

using System;
using System.Collections;
using System.Collections.Generic;
using System.Globalization;
using System.Linq;
using System.Reflection;
using System.Text;

namespace UnityEngine
{
    public static class JsonUtility
    {
        const int Deepest = 10;

        public static string ToJson(object value)
        {
            return ToJson(value, false);
        }

        public static string ToJson(object value, bool pretty)
        {
            if (value == null) return "";
            if (pretty) throw new NotSupportedException("the stand-in writes on one line");
            if (!Serialisation.IsClass(value.GetType())) return "{}"; // as of a list or a number
            var text = new StringBuilder();
            Write(text, value, value.GetType(), 0);
            return text.ToString();
        }

        public static T FromJson<T>(string json)
        {
            return (T)FromJson(json, typeof(T));
        }

        public static object FromJson(string json, Type type)
        {
            if (string.IsNullOrEmpty(json)) return null;
            var tree = new JsonReader(json).Document() as Dictionary<string, object>;
            if (tree == null) throw new ArgumentException("JSON must represent an object type.");
            return Filled(Activator.CreateInstance(type, true), tree);
        }

        static void Write(StringBuilder text, object value, Type type, int depth)
        {
            if (depth > Deepest) throw new InvalidOperationException("Serialization depth limit 10 exceeded at " + type);
            Type element = Serialisation.Element(type);
            if (element != null) WriteList(text, (IEnumerable)value, element, depth);
            else if (type == typeof(string)) WriteText(text, (string)value ?? "");
            else if (type == typeof(bool)) text.Append((bool)value ? "true" : "false");
            else if (type == typeof(float)) text.Append(NumberText.Of((float)value));
            else if (type == typeof(double)) text.Append(NumberText.Of((double)value));
            else if (type.IsEnum) text.Append(Convert.ToInt64(value).ToString(CultureInfo.InvariantCulture));
            else if (type.IsPrimitive) text.Append(Convert.ToString(value, CultureInfo.InvariantCulture));
            else WriteFields(text, value ?? Activator.CreateInstance(type, true), type, depth);
        }

        static void WriteFields(StringBuilder text, object value, Type type, int depth)
        {
            text.Append('{');
            bool first = true;
            foreach (FieldInfo field in Serialisation.Fields(type))
            {
                if (!first) text.Append(',');
                first = false;
                text.Append('"').Append(field.Name).Append("\":");
                Write(text, field.GetValue(value), field.FieldType, depth + 1);
            }
            text.Append('}');
        }

        static void WriteList(StringBuilder text, IEnumerable values, Type element, int depth)
        {
            text.Append('[');
            bool first = true;
            foreach (object each in values ?? new object[0])
            {
                if (!first) text.Append(',');
                first = false;
                Write(text, each, element, depth + 1);
            }
            text.Append(']');
        }

        static void WriteText(StringBuilder text, string value)
        {
            text.Append('"');
            foreach (char each in value)
            {
                int known = "\"\\\b\f\n\r\t".IndexOf(each);
                if (known >= 0) text.Append('\\').Append("\"\\bfnrt"[known]);
                else if (each < ' ') text.AppendFormat("\\u{0:X4}", (int)each);
                else text.Append(each);
            }
            text.Append('"');
        }

        static object Filled(object value, Dictionary<string, object> tree)
        {
            foreach (FieldInfo field in Serialisation.Fields(value.GetType()))
            {
                object found;
                if (tree.TryGetValue(field.Name, out found) && found != null)
                    field.SetValue(value, Read(found, field.FieldType, field.GetValue(value)));
                else if (field.GetValue(value) == null && Serialisation.IsClass(field.FieldType))
                    field.SetValue(value, Activator.CreateInstance(field.FieldType, true));
            }
            return value;
        }

        static object Read(object found, Type type, object before)
        {
            Type element = Serialisation.Element(type);
            if (element != null) return found is List<object> ? ReadList((List<object>)found, type, element) : before;
            if (type == typeof(string)) return found as string ?? before;
            if (type == typeof(bool)) return found is bool ? found : before;
            if (type.IsEnum) return found is double ? Enum.ToObject(type, (long)(double)found) : before;
            if (type.IsPrimitive) return found is double ? Convert.ChangeType(found, type, CultureInfo.InvariantCulture) : before;
            var tree = found as Dictionary<string, object>;
            return tree == null ? before : Filled(before ?? Activator.CreateInstance(type, true), tree);
        }

        static object ReadList(List<object> found, Type type, Type element)
        {
            Array values = Array.CreateInstance(element, found.Count);
            for (int i = 0; i < found.Count; i++)
            {
                object empty = element == typeof(string) ? "" : Activator.CreateInstance(element, true);
                values.SetValue(found[i] == null ? empty : Read(found[i], element, empty), i);
            }
            return type.IsArray ? values : Activator.CreateInstance(type, values);
        }
    }

    /// <summary>Which fields Unity serialises.</summary>
    public static class Serialisation
    {
        const BindingFlags Own = BindingFlags.Instance | BindingFlags.Public | BindingFlags.NonPublic | BindingFlags.DeclaredOnly;

        /// <summary>Those of a class, of base classes first.</summary>
        public static IEnumerable<FieldInfo> Fields(Type type)
        {
            IEnumerable<FieldInfo> inherited = type.BaseType == null ? new FieldInfo[0] : Fields(type.BaseType);
            return inherited.Concat(type.GetFields(Own).Where(IsSerialised));
        }

        static bool IsSerialised(FieldInfo field)
        {
            bool wanted = field.IsPublic || field.IsDefined(typeof(SerializeField), false);
            return wanted && !field.IsInitOnly && !field.IsLiteral && !field.IsNotSerialized && IsType(field.FieldType);
        }

        /// <summary>Whether values of a type can be serialised.</summary>
        public static bool IsType(Type type)
        {
            Type element = Element(type);
            if (element != null) return Element(element) == null && IsType(element);
            return type == typeof(string) || type.IsPrimitive || type.IsEnum || IsClass(type)
                || typeof(Object).IsAssignableFrom(type);
        }

        /// <summary>The type of an array's or a list's elements; null of what is neither.</summary>
        public static Type Element(Type type)
        {
            if (type.IsArray) return type.GetElementType();
            bool list = type.IsGenericType && type.GetGenericTypeDefinition() == typeof(List<>);
            return list ? type.GetGenericArguments()[0] : null;
        }

        /// <summary>Whether it is an object of its own, with fields: a vector, or a class or struct with Serializable.</summary>
        public static bool IsClass(Type type)
        {
            if (type == typeof(Vector2) || type == typeof(Vector3) || type == typeof(Color)) return true;
            bool own = type.IsDefined(typeof(SerializableAttribute), false) && !type.IsPrimitive && !type.IsEnum;
            return own && type != typeof(string) && !type.IsGenericType && !type.IsArray && !type.IsAbstract;
        }
    }

    /// <summary>JSON as dictionaries, lists, texts, doubles, booleans and null.</summary>
    class JsonReader
    {
        static readonly Dictionary<string, object> Words = new Dictionary<string, object>
        {
            { "true", true }, { "false", false }, { "null", null },
        };

        readonly string text;
        int at;

        public JsonReader(string text)
        {
            this.text = text;
        }

        public object Document()
        {
            object value = Value();
            if (Next() != '\0') throw Fault("nothing more");
            return value;
        }

        Exception Fault(string wanted)
        {
            return new ArgumentException("JSON parse error: expected " + wanted + " at " + at);
        }

        /// <summary>What comes after white space, without taking it.</summary>
        char Next()
        {
            while (at < text.Length && " \t\r\n".IndexOf(text[at]) >= 0) at++;
            return at < text.Length ? text[at] : '\0';
        }

        void Take(char wanted)
        {
            if (Next() != wanted) throw Fault(wanted.ToString());
            at++;
        }

        object Value()
        {
            char next = Next();
            if (next == '{') return Members();
            if (next == '[') return Items();
            if (next == '"') return Text();
            foreach (KeyValuePair<string, object> word in Words)
                if (string.CompareOrdinal(text, at, word.Key, 0, word.Key.Length) == 0)
                {
                    at += word.Key.Length;
                    return word.Value;
                }
            int start = at;
            while (at < text.Length && "+-.eE0123456789".IndexOf(text[at]) >= 0) at++;
            double number;
            if (!double.TryParse(text.Substring(start, at - start), NumberStyles.Float, CultureInfo.InvariantCulture, out number))
                throw Fault("a value");
            return number;
        }

        Dictionary<string, object> Members()
        {
            var found = new Dictionary<string, object>();
            Take('{');
            while (Next() != '}')
            {
                if (found.Count > 0) Take(',');
                Next();
                string name = Text();
                Take(':');
                found[name] = Value();
            }
            Take('}');
            return found;
        }

        List<object> Items()
        {
            var found = new List<object>();
            Take('[');
            while (Next() != ']')
            {
                if (found.Count > 0) Take(',');
                found.Add(Value());
            }
            Take(']');
            return found;
        }

        string Text()
        {
            Take('"');
            var found = new StringBuilder();
            while (at < text.Length && text[at] != '"')
            {
                char each = text[at++];
                if (each != '\\')
                {
                    found.Append(each);
                    continue;
                }
                each = text[at++];
                int known = "\"\\/bfnrt".IndexOf(each);
                if (known >= 0) found.Append("\"\\/\b\f\n\r\t"[known]);
                else found.Append((char)int.Parse(text.Substring(at, 4), NumberStyles.HexNumber));
                if (known < 0) at += 4;
            }
            Take('"');
            return found.ToString();
        }
    }
}
