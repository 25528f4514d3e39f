using System;
using System.Collections.Generic;
using System.Text;
using UnityEngine;

namespace Clothfit
{
    /// <summary>
    /// The text of a JSON object to which members can be added. JsonUtility writes all values, so numbers and texts look
    /// as they do in the rest of a file; it cannot leave a field out, which is what this class is for.
    /// </summary>
    public sealed class JsonObject
    {
        readonly StringBuilder text;

        /// <summary>An object without members, or one that JsonUtility has written.</summary>
        public JsonObject(string json = "{}")
        {
            text = new StringBuilder(json, 0, json.Length - 1, json.Length + 256); // without the closing brace
        }

        public bool IsEmpty
        {
            get { return text.Length == 1; }
        }

        public override string ToString()
        {
            return text + "}";
        }

        public JsonObject AddJson(string name, string json)
        {
            if (!IsEmpty) text.Append(',');
            text.Append('"').Append(name).Append("\":").Append(json);
            return this;
        }

        /// <summary>Adds an object if it has members.</summary>
        public JsonObject Add(string name, JsonObject value)
        {
            return value.IsEmpty ? this : AddJson(name, value.ToString());
        }

        /// <summary>Adds a number if it is set.</summary>
        public JsonObject Add(string name, float value)
        {
            return Unset.Has(value) ? AddJson(name, Value(new OneFloat { v = value })) : this;
        }

        /// <summary>Adds a vector if it is set.</summary>
        public JsonObject Add(string name, Vector3 value)
        {
            return Unset.Has(value) ? AddJson(name, Value(new OneVector { v = value })) : this;
        }

        /// <summary>Adds a text if it is not empty.</summary>
        public JsonObject Add(string name, string value)
        {
            return string.IsNullOrEmpty(value) ? this : AddJson(name, Value(new OneText { v = value }));
        }

        /// <summary>Adds a list if it is not empty.</summary>
        public JsonObject Add(string name, List<float> values)
        {
            return values.Count == 0 ? this : AddJson(name, Value(new Floats { v = values }));
        }

        public JsonObject Add(string name, List<int> values)
        {
            return values.Count == 0 ? this : AddJson(name, Value(new Integers { v = values }));
        }

        public JsonObject Add(string name, List<Vector3> values)
        {
            return values.Count == 0 ? this : AddJson(name, Value(new Vectors { v = values }));
        }

        /// <summary>The text of the one field, v, of an object.</summary>
        static string Value(object box)
        {
            string json = JsonUtility.ToJson(box);
            int start = json.IndexOf(':') + 1;
            return json.Substring(start, json.Length - 1 - start);
        }

        [Serializable]
        class OneFloat
        {
            public float v;
        }

        [Serializable]
        class OneVector
        {
            public Vector3 v;
        }

        [Serializable]
        class OneText
        {
            public string v;
        }

        [Serializable]
        class Floats
        {
            public List<float> v;
        }

        [Serializable]
        class Integers
        {
            public List<int> v;
        }

        [Serializable]
        class Vectors
        {
            public List<Vector3> v;
        }
    }
}
